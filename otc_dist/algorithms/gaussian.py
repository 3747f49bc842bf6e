"""Gaussian policies: their densities, and samples squashed into [-1, 1].

Pure functions of a policy's mean and log standard deviation, which broadcast against the noise:
one state's (B, 1, a) serve n samples (B, n, a).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor


def log_density(values: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """log N(x; mu, diag(sigma^2)) of values (..., a): (...)."""
    return _standard_log_density((values - mean) * (-log_std).exp(), log_std)


def sample_squashed(mean: Tensor, log_std: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Actions a = tanh(u), u = mu + sigma eps, and their log density.

    log pi(a) = log N(u; mu, sigma^2) - sum_i log(1 - tanh(u_i)^2)  (Haarnoja et al., 2018,
    eq. 21), the last in the form 2 (log 2 - u - softplus(-2 u)), which stays exact where tanh
    saturates.

    Args:
        mean, log_std: of u, broadcasting to (..., a).
        noise: standard normal eps (..., a).

    Returns:
        Actions (..., a) in [-1, 1] and log pi (...), differentiable in mean and log_std.
    """
    before = mean + log_std.exp() * noise
    squash = 2 * (math.log(2) - before - torch.nn.functional.softplus(-2 * before))
    return torch.tanh(before), _standard_log_density(noise, log_std) - squash.sum(-1)


def mode_squashed(mean: Tensor) -> Tensor:
    """tanh(mu): the deployed action of a squashed Gaussian policy."""
    return torch.tanh(mean)


def _standard_log_density(standard: Tensor, log_std: Tensor) -> Tensor:
    """log density of mu + sigma eps, by eps (..., a)."""
    return (-0.5 * standard**2 - log_std - 0.5 * math.log(2 * math.pi)).sum(-1)
