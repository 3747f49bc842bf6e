"""Runs any pure step function: compiled, in a CUDA graph, or eagerly.

A step maps tensors to tensors and touches nothing else, so where and how it runs is decided
here and nowhere else. Backends agree to rounding only, so a run's engine is part of its
description.
"""

import os
import shutil
from collections.abc import Callable
from typing import Any, Literal, ParamSpec, TypeVar

import torch
from torch import Tensor

from otc_dist.algorithms.draws import Draws
from otc_dist.algorithms.interface import State
from otc_dist.cache import cache_root
from otc_dist.description import EngineName
from otc_dist.errors import UserError

P = ParamSpec("P")
T = TypeVar("T")
Update = Callable[[State, Draws], tuple[State, Tensor]]
Resolved = Literal["compiled", "cuda-graph", "eager"]
VARIANTS = 256  # of one function in a process: agents differ in sizes, arms in samplers
# torch.cond's branches are part of the cache's key, but torch has not declared it cacheable.
CACHEABLE = {"torch.ops.higher_order.cond": torch.__version__}
COMPILE_WORTHWHILE = 10_000  # updates: compiling takes about a minute, an update saves 5 ms


def resolve(name: EngineName, updates: int) -> Resolved:
    """Turn `auto` into the engine for this machine and this many updates in all.

    Raises:
        UserError: an engine that this machine cannot run was asked for by name.
    """
    cuda = torch.cuda.is_available()
    compiler = shutil.which("g++") or shutil.which("clang++")
    if name == "cuda-graph" and not cuda:
        raise UserError("engine.name = 'cuda-graph' needs a CUDA device; use 'auto' or 'compiled'")
    if name == "compiled" and not compiler:
        raise UserError("engine.name = 'compiled' needs g++ or clang++; install one or use 'eager'")
    if name != "auto":
        return name
    if cuda:
        return "cuda-graph"
    return "compiled" if compiler and updates >= COMPILE_WORTHWHILE else "eager"


class Engine:
    """How and where pure functions of tensors run.

    `fuse` compiles a function; `record` turns a whole update, made of fused functions and
    gathers, into one launch where that pays (a CUDA graph).
    """

    def __init__(self, name: Resolved) -> None:
        self.name = name
        self.device = torch.device("cuda" if name == "cuda-graph" else "cpu")
        # Sums split over threads round otherwise, and a brain's networks are too small to gain.
        torch.set_num_threads(1)
        # Compiled code outlives the process: other learners and later runs load it.
        os.environ.setdefault("TORCHINDUCTOR_CACHE_DIR", str(cache_root() / "compiled"))
        # The default of 8 ends a process that holds more brains than that with an error.
        torch._dynamo.config.recompile_limit = VARIANTS

    def fuse(self, function: Callable[P, T]) -> Callable[P, T]:
        """`function` with the same results up to rounding; argument shapes must not vary."""
        if self.name == "eager":
            return torch.no_grad()(function)
        options: dict[str, Any] = {
            "cpp_wrapper": self.device.type == "cpu",
            "unsafe_marked_cacheable_functions": CACHEABLE,
        }
        return torch.no_grad()(
            torch.compile(function, fullgraph=True, dynamic=False, options=options)
        )

    def record(self, update: Update) -> Update:
        """`update` itself, or on a GPU its recording, replayed at every later call."""
        return _CudaGraph(update) if self.name == "cuda-graph" else update


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
        self._draws: dict[str, Tensor] = {}
        self._metrics = torch.empty(0)

    def __call__(self, state: State, draws: Draws) -> tuple[State, Tensor]:
        if self._graph is None:
            self._record(state, draws)
        for name, tensor in draws.items():
            self._draws[name].copy_(tensor)
        for name, tensor in state.items():
            if tensor is not self._state[name]:
                self._state[name].copy_(tensor)
        assert self._graph is not None
        self._graph.replay()
        return self._state, self._metrics

    def _record(self, state: State, draws: Draws) -> None:
        self._state = {name: tensor.clone() for name, tensor in state.items()}
        self._draws = {name: tensor.clone() for name, tensor in draws.items()}
        stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(self.WARM_UP):
                self._update(self._state, self._draws)
        torch.cuda.current_stream().wait_stream(stream)
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self._graph):
            new, self._metrics = self._update(self._state, self._draws)
            for name, tensor in new.items():
                self._state[name].copy_(tensor)
