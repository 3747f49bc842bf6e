"""One trust-region step of a Gaussian policy of fixed deviation, from states it has visited.

What is computed for all states is a pure function that the engine runs; what to compute next, in
the line search, depends on what was found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from otc_dist.algorithms.bremen.trust_region import Step, gauss_newton_product, trust_region_step
from otc_dist.steps.networks import Mlp, value_and_gradient
from otc_dist.steps.state import Fuse
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor

# The Fisher matrix is computed from every ninth state: a tenth was enough for TRPO's authors.
# 9 and the usual batch of 128 have no common divisor, so that all rollouts contribute.
FISHER_STRIDE = 9
# States judged at once: all of them would take 100 MB of layers. A twentieth of BREMEN's usual
# 128 x 100, so that what judges a part is compiled once and not again for a remainder.
PART = 640


@dataclass(frozen=True)
class PolicyStep:
    """A step of the policy N(tanh f(s), std^2), of parameters (n,), by TRPO.

    Attributes:
        actor: f.
        std: its fixed deviation.
        radius: delta, the largest mean KL divergence of a step, nats.
    """

    actor: Mlp
    std: float
    radius: float

    def __call__(
        self, fuse: Fuse, policy: Tensor, observations: Tensor, actions: Tensor, advantages: Tensor
    ) -> Step:
        """The step that maximises  L = E[pi(a|s) / pi_old(a|s) A],  A standardised, within
        E[KL(pi_old || pi)] <= delta,  KL = |mu_old - mu|^2 / (2 std^2).

        Args:
            policy: theta_old (n,).
            observations: as the actor takes them (N, s).
            actions: as drawn (N, a).
            advantages: (N,).
        """
        centred = (advantages - advantages.mean()) / (advantages.std(correction=0) + 1e-8)
        weights = centred / len(centred)
        slope, evaluate, fisher = fuse(self.slope), fuse(self.evaluate), fuse(self.fisher)
        parts, gradient = [], torch.zeros_like(policy)
        split = (torch.split(rows, PART) for rows in (observations, actions, weights))
        for part in zip(*split, strict=True):
            old, share = slope(policy, *part)
            parts.append((*part, old))
            gradient = gradient + share

        def outcome(policy: Tensor) -> tuple[Tensor, Tensor]:
            judged = [evaluate(policy, *part) for part in parts]
            gain, divergence = torch.stack([torch.stack(one) for one in judged]).sum(0)
            return gain, divergence / len(observations)

        some = observations[::FISHER_STRIDE].contiguous()
        return trust_region_step(
            policy, gradient, outcome, lambda vector: fisher(policy, some, vector), self.radius
        )

    def mean(self, policy: Tensor, observations: Tensor) -> Tensor:
        """mu(s) = tanh f(s) (..., a)."""
        return self.actor.apply(policy, observations).tanh()

    def slope(
        self, policy: Tensor, observations: Tensor, actions: Tensor, weights: Tensor
    ) -> tuple[Tensor, Tensor]:
        """mu_old (N, a), and the gradient of  sum_i w_i pi(a_i|s_i) / pi_old(a_i|s_i)  (n,)."""
        old = self.mean(policy, observations)

        def gain(new: Tensor) -> Tensor:
            return self._ratio_less_one(self.mean(new, observations), old, actions) @ weights

        return old, value_and_gradient(gain, policy)[1]

    def evaluate(
        self, policy: Tensor, observations: Tensor, actions: Tensor, weights: Tensor, old: Tensor
    ) -> tuple[Tensor, Tensor]:
        """sum_i w_i (pi(a_i|s_i) / pi_old(a_i|s_i) - 1), and sum_i KL(pi_old(s_i) || pi(s_i))."""
        new = self.mean(policy, observations)
        divergence = ((new - old) ** 2).sum() / (2 * self.std**2)
        return self._ratio_less_one(new, old, actions) @ weights, divergence

    def fisher(self, policy: Tensor, observations: Tensor, vector: Tensor) -> Tensor:
        """F v (n,), F the Hessian of E[KL(pi_old || pi)] at pi_old = pi."""
        product = gauss_newton_product(
            lambda policy: self.mean(policy, observations), policy, vector
        )
        return product / (self.std**2 * len(observations))

    def _ratio_less_one(self, new: Tensor, old: Tensor, actions: Tensor) -> Tensor:
        """pi(a|s) / pi_old(a|s) - 1 (N,), for means and actions (N, a)."""
        distances = ((actions - old) ** 2 - (actions - new) ** 2).sum(-1)
        return torch.expm1(distances / (2 * self.std**2))
