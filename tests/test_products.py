"""Matrix products in compiled code, large or thin: equal to torch's own."""

from collections.abc import Callable, Mapping

import pytest
import torch
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx

from otc_dist.engine import Engine
from otc_dist.products import Products

Sizes = Mapping[str, tuple[tuple[int, ...], tuple[int, ...]]]
SIDES: Sizes = {
    "matrices": ((96, 160), (160, 128)),
    "a transposed right": ((96, 160), (128, 160)),
    "a transposed left": ((160, 96), (160, 128)),
    "a batch": ((3, 64, 200), (3, 200, 96)),
    "small matrices": ((32, 16), (16, 32)),
    "a large batch": ((9, 64, 200), (9, 200, 96)),
}
LARGE = 4  # of these: the first four
THIN: Sizes = {
    "matrices": ((128, 256), (256, 11)),
    "a transposed right": ((128, 256), (4, 256)),
    "a transposed left": ((256, 128), (256, 7)),
    "a batch": ((5, 128, 64), (5, 64, 12)),
    "one column": ((128, 256), (256, 1)),
    "not so thin": ((128, 64), (64, 13)),
    "low": ((32, 256), (256, 11)),
    "shallow": ((128, 32), (32, 11)),
}
TRANSPOSED = 4  # of these


def function(name: str) -> Callable[[Tensor, Tensor], Tensor]:
    def multiply(left: Tensor, right: Tensor) -> Tensor:
        left = left.mT if name == "a transposed left" else left
        right = right.mT if name == "a transposed right" else right
        return torch.relu(torch.matmul(left, right)) + 1

    return multiply


def sides(name: str, of: Sizes = SIDES) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    left, right = (torch.randn(size, generator=generator) for size in of[name])
    return left, right


@pytest.mark.parametrize("name", SIDES)
def test_large_products_are_replaced_by_equal_ones(name: str) -> None:
    multiply, (left, right) = function(name), sides(name)
    traced = make_fx(multiply, tracing_mode="fake")(left, right)
    Products()(traced.graph)
    traced.graph.lint()
    replaced = traced.graph.find_nodes(
        op="call_function", target=torch.ops.otc_dist.product.default
    )
    assert bool(replaced) == (name in list(SIDES)[:LARGE])
    traced.recompile()
    torch.testing.assert_close(traced(left, right), multiply(left, right), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("name", THIN)
def test_thin_products_are_transposed(name: str) -> None:
    multiply, (left, right) = function(name), sides(name, THIN)
    traced = make_fx(multiply, tracing_mode="fake")(left, right)
    Products()(traced.graph)
    traced.graph.lint()
    (found,) = (
        node
        for target in (torch.ops.aten.mm.default, torch.ops.aten.bmm.default)
        for node in traced.graph.find_nodes(op="call_function", target=target)
    )
    columns = multiply(left, right).shape[-1]
    assert (found.meta["val"].shape[-1] > columns) == (name in list(THIN)[:TRANSPOSED])
    traced.recompile()
    torch.testing.assert_close(traced(left, right), multiply(left, right), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("of", [SIDES, THIN])
def test_other_precisions_are_left_alone(of: Sizes) -> None:
    multiply = function("matrices")
    left, right = (side.double() for side in sides("matrices", of))
    traced = make_fx(multiply, tracing_mode="fake")(left, right)
    before = str(traced.graph)
    Products()(traced.graph)
    assert str(traced.graph) == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "of"),
    [(name, SIDES) for name in list(SIDES)[:LARGE]]
    + [(name, THIN) for name in list(THIN)[:TRANSPOSED]],
)
def test_compiled_products_equal_eager_ones(name: str, of: Sizes) -> None:
    multiply, (left, right) = function(name), sides(name, of)
    compiled = Engine("compiled").fuse(multiply)
    torch.testing.assert_close(compiled(left, right), multiply(left, right), rtol=1e-5, atol=1e-4)
