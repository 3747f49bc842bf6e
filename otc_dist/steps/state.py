"""What a step is: a pure function of tensors, and the state that it takes and returns."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, ParamSpec, Protocol, TypeVar

if TYPE_CHECKING:
    from torch import Tensor

State = dict[str, "Tensor"]
P = ParamSpec("P")
T = TypeVar("T")


class Fuse(Protocol):
    """`Engine.fuse`: the same function with the same results up to rounding.

    Of a plain function or a method, whose own and enclosed values are hashable, and whose
    arguments always have the same shapes and strides: others are compiled anew.
    """

    def __call__(self, function: Callable[P, T], /) -> Callable[P, T]: ...
