"""Runs any pure step function: compiled, in a CUDA graph, or eagerly.

A step maps tensors to tensors and touches nothing else, so where and how it runs is decided
here and nowhere else. Backends agree to rounding only, so a run's engine is part of its
description.
"""

import os
import shutil
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from threading import Thread
from types import FunctionType, MethodType
from typing import Any, Literal, cast

import torch
from torch import Tensor

from otc_dist.description.sections import EngineName, EngineSection, ProductsName
from otc_dist.steps import torch_internals
from otc_dist.steps.noise import Noise
from otc_dist.steps.state import P, State, T
from otc_dist.system.cache import compiled_root
from otc_dist.terminal.errors import UserError

Update = Callable[[State, Noise], tuple[State, Tensor]]
Resolved = Literal["compiled", "cuda-graph", "eager"]
Products = Literal["own", "torch"]
COMPILE_WORTHWHILE = 10_000  # updates: compiling takes about a minute, an update saves 5 ms


def resolve(asked: EngineSection, updates: int) -> EngineSection:
    """`asked` without `auto`: for this machine, its torch and this many updates in all.

    Raises:
        UserError: what this machine or its torch cannot run was asked for by name.
    """
    name = _named(asked.name, updates)
    return EngineSection(name=name, products=_multiplied(asked.products, name))


def _named(name: EngineName, updates: int) -> Resolved:
    cuda = torch.cuda.is_available()
    compiler = _compiler()
    if name == "cuda-graph" and not cuda:
        raise UserError("engine.name = 'cuda-graph' needs a CUDA device; use 'auto' or 'compiled'")
    if name == "compiled" and not compiler:
        raise UserError("engine.name = 'compiled' needs g++ or clang++; install one or use 'eager'")
    if name != "auto":
        return name
    if cuda:
        return "cuda-graph"
    return "compiled" if compiler and updates >= COMPILE_WORTHWHILE else "eager"


def _multiplied(products: ProductsName, name: Resolved) -> Products:
    """Who multiplies matrices under an engine: only compiled code of the CPU has ours."""
    compiler = _compiler()
    if name != "compiled" or products == "torch" or not compiler:
        return "torch"
    _keep_compiled()
    if torch_internals.multiplies(compiler):
        return "own"
    if products == "own":
        raise UserError(
            f"engine.products = 'own' does not work here, with torch {torch.__version__} on this"
            " processor: a run that has it cannot go on here; a new one may use 'torch'"
        )
    return "torch"


def check(resolved: EngineSection) -> None:
    """See that compiled code computes rightly, before all of it is compiled.

    Raises:
        UserError: products of our own do not work with this torch, though it has all they need.
    """
    compiler = _compiler()
    if resolved.products == "own" and compiler:
        _keep_compiled()
        if fault := torch_internals.try_product(compiler):
            raise UserError(
                f"matrix products of our own fail with torch {torch.__version__} ({fault}); start"
                " with --set engine.products=torch"
            )


@contextmanager
def compiling(resolved: EngineSection) -> Iterator[None]:
    """Where much is compiled: a second core does what can be done beside.

    Raises:
        UserError: as `check`.
    """
    check(resolved)
    if resolved.name != "compiled":
        yield
        return
    _keep_compiled()
    beside = Thread(target=torch_internals.compile_headers)
    beside.start()
    try:
        yield
    finally:
        beside.join()


def _compiler() -> str | None:
    """The path of a C++ compiler."""
    return shutil.which("g++") or shutil.which("clang++")


def _keep_compiled() -> None:
    """Compiled code outlives the process: other learners and later runs load it."""
    if "TORCHINDUCTOR_CACHE_DIR" not in os.environ:
        os.environ["TORCHINDUCTOR_CACHE_DIR"] = str(compiled_root())


class Engine:
    """How and where pure functions of tensors run.

    `fuse` compiles a function; `record` turns a whole update, made of fused functions and
    gathers, into one launch where that pays (a CUDA graph).
    """

    def __init__(self, name: Resolved, products: Products = "torch") -> None:
        self.name, self.products = name, products
        self.device = torch.device("cuda" if name == "cuda-graph" else "cpu")
        # Sums split over threads round differently, and a brain's networks are too small to gain.
        torch.set_num_threads(1)
        if name != "eager":
            _keep_compiled()

    @classmethod
    def of(cls, asked: EngineSection, updates: int) -> "Engine":
        """The engine that `resolve` gives. Raises UserError, as it does."""
        found = resolve(asked, updates)
        return cls(cast(Resolved, found.name), cast(Products, found.products))

    def fuse(self, function: Callable[P, T]) -> Callable[P, T]:
        """`function` with the same results up to rounding; argument shapes must not vary.

        Functions with the same code that hold equal values are compiled once in a process.
        """
        if self.name == "eager":
            return torch.no_grad()(function)
        anatomy = _FunctionIdentity(function)
        key = (self.name, self.products, *anatomy.identity)
        if key not in _fused:
            _fused[key] = self._compile(anatomy)
        return cast(Callable[P, T], _fused[key])

    def _compile(self, anatomy: "_FunctionIdentity") -> Callable[..., Any]:
        on_cpu = self.device.type == "cpu"
        options = torch_internals.options(
            anatomy.arguments,
            on_cpu=on_cpu,
            compiler=_compiler() if self.products == "own" else None,
        )
        compiled = torch.no_grad()(
            torch.compile(anatomy.copy(), fullgraph=True, dynamic=False, options=options)
        )
        # A CUDA graph is called once.
        return torch_internals.called_directly(compiled) if on_cpu else compiled

    def record(self, update: Update) -> Update:
        """`update` itself, or on a GPU its recording, replayed at every later call."""
        return _CudaGraph(update) if self.name == "cuda-graph" else update


# Compiled functions by what makes them. Torch itself would compare all that a function looks at
# before every call, which takes a fifth of an update's time.
_fused: dict[Hashable, Callable[..., Any]] = {}


class _FunctionIdentity:
    """What a function consists of: its code, and the values that it holds.

    Attributes:
        identity: equal for functions that do the same. The values must be hashable.
        arguments: the names of its arguments.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._owner: tuple[object, ...] = ()
        if isinstance(function, MethodType):
            self._owner, function = (function.__self__,), function.__func__
        assert isinstance(function, FunctionType)
        self._function, code = function, function.__code__
        held = (cell.cell_contents for cell in function.__closure__ or ())
        bound = (*self._owner, *(function.__defaults__ or ()), *held)
        self.identity: tuple[Hashable, ...] = (function.__module__, code, *bound)
        self.arguments = frozenset(code.co_varnames[len(self._owner) : code.co_argcount])

    def copy(self) -> Callable[..., Any]:
        """The same function, whose code torch has never seen."""
        plain = self._function
        copy = FunctionType(
            plain.__code__.replace(), plain.__globals__, None, plain.__defaults__, plain.__closure__
        )
        return MethodType(copy, *self._owner) if self._owner else copy


class _CudaGraph:
    """An update recorded once as a CUDA graph over static memory.

    The state lives in that memory from the first call on: the state that a call returns is
    overwritten by the next.
    """

    WARM_UP = 3  # calls before recording, as CUDA graphs require: compilation, lazy handles

    def __init__(self, update: Update) -> None:
        self._update = update
        self._graph: torch.cuda.CUDAGraph | None = None
        self._state: State = {}
        self._sampled: dict[str, Tensor] = {}
        self._metrics = torch.empty(0)

    def __call__(self, state: State, sampled: Noise) -> tuple[State, Tensor]:
        if self._graph is None:
            self._record(state, sampled)
        for name, tensor in sampled.items():
            self._sampled[name].copy_(tensor)
        for name, tensor in state.items():
            if tensor is not self._state[name]:
                self._state[name].copy_(tensor)
        assert self._graph is not None
        self._graph.replay()
        return self._state, self._metrics

    def _record(self, state: State, sampled: Noise) -> None:
        self._state = {name: tensor.clone() for name, tensor in state.items()}
        self._sampled = {name: tensor.clone() for name, tensor in sampled.items()}
        stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(self.WARM_UP):
                self._update(self._state, self._sampled)
        torch.cuda.current_stream().wait_stream(stream)
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self._graph):
            new, self._metrics = self._update(self._state, self._sampled)
            for name, tensor in new.items():
                self._state[name].copy_(tensor)
