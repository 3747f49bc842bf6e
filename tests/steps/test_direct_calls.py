"""Compiled code called without torch: which calls go which way, and that both do the same."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from otc_dist.steps.direct_calls import DirectCalls


class Pair(NamedTuple):
    product: Tensor
    nothing: None


def products(
    state: dict[str, Tensor], left: Tensor, right: Tensor, more: tuple[Tensor, ...] | None = None
) -> tuple[dict[str, Tensor], Pair]:
    """What torch compiles without a C++ compiler; something is handed on as it is."""
    new = {**state, "weight": state["weight"] @ left}
    return new, Pair(left @ right, None)


@pytest.fixture
def direct() -> Iterator[tuple[DirectCalls[..., object], list[int]]]:
    """`products`, and the numbers of calls that went through torch."""
    compiled, slow = torch.no_grad()(torch.compile(products, fullgraph=True, dynamic=False)), [0]

    def counted(*arguments: object) -> object:
        slow[0] += 1
        return compiled(*arguments)

    yield DirectCalls(counted), slow
    torch.compiler.reset()


def square(size: int, seed: int) -> Tensor:
    return torch.randn(size, size, generator=torch.Generator().manual_seed(seed))


def case(seed: int, size: int = 3) -> tuple[dict[str, Tensor], Tensor, Tensor]:
    state = {"kept": square(size, seed), "weight": square(size, seed + 1)}
    return state, square(size, seed + 2), square(size, seed + 3)


def same(direct: Callable[..., object], *arguments: object) -> None:
    """Whether it does as `products`, to the object where one is handed on."""
    new, pair = direct(*arguments)  # type: ignore[misc]
    wanted, products_pair = products(*arguments)  # type: ignore[arg-type]
    assert list(new) == list(wanted) and new["kept"] is wanted["kept"]
    assert type(pair) is Pair and pair.nothing is None
    assert torch.equal(new["weight"], wanted["weight"])
    assert torch.equal(pair.product, products_pair.product)


def test_calls_that_are_alike_go_through_torch_once(
    direct: tuple[DirectCalls[..., object], list[int]],
) -> None:
    function, slow = direct
    for seed in range(4):
        same(function, *case(seed))
    assert slow == [1]
    # Other sizes, another order of strides, other types, one tensor in two places, other arguments.
    state, left, right = case(9)
    others = (
        case(9, size=4),
        (state, left.T, right),
        ({name: item.double() for name, item in state.items()}, left.double(), right.double()),
        (state, left, left),
        (state, left, right, None),
        (state, left, right, (left, right)),
    )
    for number, arguments in enumerate(others):
        same(function, *arguments)
        same(function, *arguments)
        assert slow == [2 + number], arguments
    same(function, *case(5))
    same(function, state, left, left)
    assert slow == [1 + len(others)]


def test_whatever_is_no_tensor_goes_through_torch(
    direct: tuple[DirectCalls[..., object], list[int]],
) -> None:
    function, slow = direct
    for count in range(1, 3):
        same(function, *case(0), "more")
        assert slow == [count]


def test_a_result_that_torch_adds_to_goes_through_torch() -> None:
    """A view of an argument is made by torch and not by the code."""

    def views(left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        return left.view(-1), left @ right

    function = DirectCalls(torch.no_grad()(torch.compile(views, fullgraph=True, dynamic=False)))
    for seed in range(3):
        left, right = square(3, seed), square(3, seed + 1)
        view, product = function(left, right)
        assert view.data_ptr() == left.data_ptr() and torch.equal(view, left.view(-1))
        assert torch.equal(product, left @ right)
