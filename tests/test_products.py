"""Large matrix products in compiled code: oneDNN's, equal to torch's own."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx

from otc_dist.engine import Engine
from otc_dist.products import LargeProducts

SIDES = {
    "matrices": ((96, 160), (160, 128)),
    "a transposed right": ((96, 160), (128, 160)),
    "a transposed left": ((160, 96), (160, 128)),
    "a batch": ((3, 64, 200), (3, 200, 96)),
    "small matrices": ((32, 16), (16, 32)),
    "a large batch": ((9, 64, 200), (9, 200, 96)),
}
LARGE = 4  # of these: the first four


def function(name: str) -> Callable[[Tensor, Tensor], Tensor]:
    def multiply(left: Tensor, right: Tensor) -> Tensor:
        left = left.mT if name == "a transposed left" else left
        right = right.mT if name == "a transposed right" else right
        return torch.relu(torch.matmul(left, right)) + 1

    return multiply


def sides(name: str) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    left, right = (torch.randn(size, generator=generator) for size in SIDES[name])
    return left, right


@pytest.mark.parametrize("name", SIDES)
def test_large_products_are_replaced_by_equal_ones(name: str) -> None:
    multiply, (left, right) = function(name), sides(name)
    traced = make_fx(multiply, tracing_mode="fake")(left, right)
    LargeProducts()(traced.graph)
    traced.graph.lint()
    replaced = traced.graph.find_nodes(
        op="call_function", target=torch.ops.otc_dist.product.default
    )
    assert bool(replaced) == (name in list(SIDES)[:LARGE])
    traced.recompile()
    torch.testing.assert_close(traced(left, right), multiply(left, right), rtol=1e-5, atol=1e-4)


def test_other_precisions_are_left_alone() -> None:
    multiply = function("matrices")
    left, right = (side.double() for side in sides("matrices"))
    traced = make_fx(multiply, tracing_mode="fake")(left, right)
    before = str(traced.graph)
    LargeProducts()(traced.graph)
    assert str(traced.graph) == before


@pytest.mark.slow
@pytest.mark.parametrize("name", list(SIDES)[:LARGE])
def test_compiled_products_equal_eager_ones(name: str) -> None:
    multiply, (left, right) = function(name), sides(name)
    compiled = Engine("compiled").fuse(multiply)
    torch.testing.assert_close(compiled(left, right), multiply(left, right), rtol=1e-5, atol=1e-4)
