"""Several states at once: every tensor has one more axis in front, along which they lie.

A pure function of one state is a function of several by `each`. A GPU that one small update leaves
idle makes those of several seeds in one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from typing import TYPE_CHECKING

from otc_dist.steps.state import P, State, T
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor

_mapped: ContextVar[bool] = ContextVar("_mapped", default=False)


def stack(states: Sequence[Mapping[str, Tensor]]) -> State:
    """States of equal shapes as one."""
    return {name: torch.stack([state[name] for state in states]) for name in states[0]}


def unstack(stacked: Mapping[str, Tensor]) -> list[State]:
    """The inverse of `stack`; each state has memory of its own."""
    apart = zip(*(tensor.unbind() for tensor in stacked.values()), strict=True)
    return [{name: x.clone() for name, x in zip(stacked, one, strict=True)} for one in apart]


def each(function: Callable[P, T]) -> Callable[P, T]:
    """`function` of stacked tensors: what it gives for each of them, stacked, up to rounding."""

    def mapped(*arguments: P.args, **named: P.kwargs) -> T:
        before = _mapped.set(True)
        try:
            return function(*arguments, **named)
        finally:
            _mapped.reset(before)

    def of_all(*arguments: P.args, **named: P.kwargs) -> T:
        # What is compiled knows without the mark, and could not set it.
        one = function if torch.compiler.is_compiling() else mapped
        found: T = torch.func.vmap(one)(*arguments, **named)
        return found

    return of_all


def is_mapped() -> bool:
    """Whether `each` runs this: a tensor may stand for several, which no branch can ask, and whose
    gradient only `torch.func` finds.
    """
    return _mapped.get()
