"""Networks side by side: large float32 products take another path to the same numbers."""

import numpy as np
import pytest
import torch
from torch import Tensor

from otc_dist.steps.networks import LARGE, Mlp, value_and_gradient

TWINS = Mlp(inputs=(5, 2), hidden=(128, 128), outputs=1, copies=2)


@pytest.mark.parametrize("states", [16, 2])  # the second below LARGE
def test_outputs_and_gradients_of_large_products_are_those_of_double_precision(
    states: int,
) -> None:
    random = np.random.default_rng(0)
    actions = 12
    assert (states * actions * 128 * 128 >= LARGE) == (states == 16)
    parameters = torch.from_numpy(TWINS.initialise(random))
    s = torch.from_numpy(random.standard_normal((states, 1, 5)))
    a = torch.from_numpy(random.standard_normal((states, actions, 2)))
    towards = torch.from_numpy(random.standard_normal((2, states, actions, 1)))

    def loss(parameters: Tensor, dtype: torch.dtype) -> Tensor:
        outputs = TWINS.apply(parameters, s.to(dtype), a.to(dtype))
        assert outputs.shape == towards.shape
        return (outputs * towards.to(dtype)).sum()

    exact = value_and_gradient(lambda p: loss(p, torch.float64), parameters)
    single = value_and_gradient(lambda p: loss(p, torch.float32), parameters.float())
    for wanted, found in zip(exact, single, strict=True):
        scale = float(wanted.abs().max())
        np.testing.assert_allclose(found.double(), wanted, rtol=0, atol=2e-5 * max(scale, 1))
