"""Compiled code called without what torch does around it.

At every call `torch.compile` finds out whether its code fits the arguments, and passes through a
dozen layers of Python: 25 us, a seventh of a small network's update. Here the first call is watched
for which arguments the code takes and where its results go, and later ones run the code itself.
"""

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from operator import itemgetter
from typing import Any, Generic, NamedTuple

from torch import Tensor
from torch._inductor.output_code import CompiledFxGraph

from otc_dist.steps.state import P, T

Code = Callable[[list[Tensor]], Sequence[Tensor]]  # which empties the list that it is given
Build = Callable[[Sequence[Tensor]], Any]


def check() -> None:
    """Raises AttributeError if the installed torch keeps its code elsewhere."""
    if "current_callable" not in CompiledFxGraph.__annotations__:
        raise AttributeError("CompiledFxGraph has no current_callable")


class _Call(NamedTuple):
    """One call of compiled code."""

    code: Code
    given: list[Tensor]
    results: Sequence[Tensor]


class _Route(NamedTuple):
    """How a call becomes one of the code itself."""

    code: Code
    takes: list[int]  # which of the tensors among the arguments
    build: Build  # the function's result, from the code's results followed by those tensors


class DirectCalls(Generic[P, T]):
    """A compiled pure function of tensors, alone or in dictionaries and tuples.

    Calls are alike whose tensors have the same names, sizes, strides and types, and are the same
    object in the same places. The first of them goes through torch, which compiles if it must.
    So does every call of a function whose result is not all its arguments and what its code
    returns, or that is given anything else.
    """

    def __init__(self, compiled: Callable[P, T]) -> None:
        self._compiled = compiled
        self._routes: dict[tuple[object, ...], _Route | None] = {}

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T:
        tensors: list[Tensor] = []
        kind: list[object] = []
        if kwargs or not all(_collect(argument, tensors, kind) for argument in args):
            return self._compiled(*args, **kwargs)
        places: dict[int, int] = {}
        for place, tensor in enumerate(tensors):
            kind.append(places.setdefault(id(tensor), place))
        known = tuple(kind)
        if known not in self._routes:
            with _no_collection(), _watched() as calls:
                result = self._compiled(*args, **kwargs)
            self._routes[known] = _route(calls, tensors, result)
            return result
        if (route := self._routes[known]) is None:
            return self._compiled(*args, **kwargs)
        results = route.code([tensors[place] for place in route.takes])
        return route.build([*results, *tensors])  # type: ignore[no-any-return]


def _collect(argument: object, tensors: list[Tensor], kind: list[object]) -> bool:
    """Adds an argument's tensors, and what tells it from arguments that are not alike; False: it
    has something else.
    """
    if isinstance(argument, Tensor):
        tensors.append(argument)
        kind += (argument.shape, argument.stride(), argument.dtype)
        return True
    if isinstance(argument, Mapping):
        kind.append(tuple(argument))
        return all(_collect(item, tensors, kind) for item in argument.values())
    if isinstance(argument, tuple):
        kind.append((type(argument), len(argument)))
        return all(_collect(item, tensors, kind) for item in argument)
    kind.append(None)
    return argument is None


@contextmanager
def _no_collection() -> Iterator[None]:
    """No search for garbage: what torch makes while it compiles is mostly kept, and there is so
    much of it that the search takes a tenth of the time.
    """
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@contextmanager
def _watched() -> Iterator[list[_Call]]:
    """The calls of compiled code that are made meanwhile."""
    calls: list[_Call] = []
    plain = CompiledFxGraph.__call__

    def watched(self: CompiledFxGraph, inputs: Sequence[Any]) -> Any:
        given = list(inputs)
        results = plain(self, inputs)
        assert self.current_callable is not None
        calls.append(_Call(self.current_callable, given, results))
        return results

    CompiledFxGraph.__call__ = watched  # type: ignore[method-assign]
    try:
        yield calls
    finally:
        CompiledFxGraph.__call__ = plain  # type: ignore[method-assign]


def _route(calls: Sequence[_Call], tensors: Sequence[Tensor], result: object) -> _Route | None:
    """The route of all calls like this one; None: there is none."""
    if len(calls) != 1:
        return None
    code, given, results = calls[0]
    arguments = {id(tensor): place for place, tensor in enumerate(tensors)}
    available = {id(tensor): place for place, tensor in enumerate((*results, *tensors))}
    try:
        takes = [arguments[id(tensor)] for tensor in given]
        return _Route(code, takes, _builder(result, available))
    except KeyError:
        return None


def _builder(result: object, available: Mapping[int, int]) -> Build:
    """What builds such a result from tensors, of which `available` says where each is, by its id.

    Raises:
        KeyError: it has something that is not there.
    """
    if isinstance(result, Tensor):
        return itemgetter(available[id(result)])
    if isinstance(result, Mapping):
        named = {name: _builder(item, available) for name, item in result.items()}
        return lambda tensors: {name: build(tensors) for name, build in named.items()}
    if isinstance(result, tuple):
        parts = [_builder(item, available) for item in result]
        make: Callable[..., Any] = getattr(type(result), "_make", tuple)
        return lambda tensors: make([build(tensors) for build in parts])
    if result is None:
        return lambda tensors: None
    raise KeyError(result)
