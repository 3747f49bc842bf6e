"""The engine: what runs a step, and that every backend computes the same."""

import os
from collections.abc import Callable
from pathlib import Path
from threading import Event, current_thread, main_thread

import numpy as np
import pytest
import torch
from torch._dynamo.utils import counters
from torch._inductor.codecache import CppWrapperCodeCache

from otc_dist.description.sections import EngineName, EngineSection, ProductsName
from otc_dist.learner.learner import Learner
from otc_dist.learner.trainer import Phase
from otc_dist.steps import engine, torch_internals
from otc_dist.steps.engine import Engine
from otc_dist.steps.noise import to_tensors
from otc_dist.system.cache import compiled_root
from otc_dist.terminal.errors import UserError

from ..brains import ARMS, brain, online, silent, unsaved

CPU = torch.device("cpu")


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    def pretend(*, compiler: str | None, cuda: bool, own: bool = True) -> None:
        monkeypatch.setattr(
            "shutil.which", lambda name: f"/usr/bin/{name}" if name == compiler else None
        )
        monkeypatch.setattr("torch.cuda.is_available", lambda: cuda)
        monkeypatch.setattr(torch_internals, "multiplies", lambda compiler: own)

    return pretend


def resolve(name: EngineName, updates: int, products: ProductsName = "auto") -> tuple[str, str]:
    found = engine.resolve(EngineSection(name=name, products=products), updates)
    return found.name, found.products


@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_auto_compiles_where_it_pays(machine: Callable[..., None], compiler: str) -> None:
    machine(compiler=compiler, cuda=False)
    assert resolve("auto", engine.COMPILE_WORTHWHILE) == ("compiled", "own")
    assert resolve("auto", engine.COMPILE_WORTHWHILE - 1) == ("eager", "torch")
    assert resolve("compiled", 1) == ("compiled", "own")
    assert resolve("eager", 10**6) == ("eager", "torch")


def test_auto_without_a_compiler_is_eager(machine: Callable[..., None]) -> None:
    machine(compiler=None, cuda=False)
    assert resolve("auto", 10**6) == ("eager", "torch")
    with pytest.raises(UserError, match="needs g\\+\\+ or clang\\+\\+"):
        resolve("compiled", 10**6)


def test_auto_with_a_gpu_is_a_cuda_graph(machine: Callable[..., None]) -> None:
    machine(compiler=None, cuda=True)
    assert resolve("auto", 1) == ("cuda-graph", "torch")
    assert resolve("eager", 1) == ("eager", "torch")


def test_a_cuda_graph_without_a_gpu_is_refused(machine: Callable[..., None]) -> None:
    machine(compiler="g++", cuda=False)
    with pytest.raises(UserError, match="needs a CUDA device"):
        resolve("cuda-graph", 1)


def test_a_run_with_products_of_our_own_goes_on_with_them_or_not_at_all(
    machine: Callable[..., None],
) -> None:
    machine(compiler="g++", cuda=False)
    assert resolve("compiled", 1, "own") == ("compiled", "own")
    assert resolve("compiled", 1, "torch") == ("compiled", "torch")
    machine(compiler="g++", cuda=False, own=False)
    assert resolve("compiled", 1) == ("compiled", "torch")
    with pytest.raises(UserError, match=r"engine\.products = 'own' does not work here") as refused:
        resolve("compiled", 1, "own")
    assert "\n" not in str(refused.value)


def test_results_do_not_depend_on_how_many_threads_there_were() -> None:
    """Sums that are split over threads round differently."""
    before = torch.get_num_threads()
    digests = set()
    try:
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            learner = brain(
                *ARMS["uniform"], "algorithm.hidden=[64,64]", "algorithm.batch_size=128"
            )
            learner.pretrain(silent, unsaved)
            digests.add(learner.policy_digest())
    finally:
        torch.set_num_threads(before)
    assert len(digests) == 1


def test_headers_are_compiled_beside_whatever_becomes_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked, told = Event(), list[object]()
    monkeypatch.setattr("threading.excepthook", told.append)

    def load_async(code: str, **options: object) -> None:
        assert current_thread() is not main_thread()
        asked.set()
        raise OSError("no space left")

    monkeypatch.setattr(CppWrapperCodeCache, "load_async", load_async)
    for name, headers in (("eager", False), ("compiled", True)):
        with engine.compiling(EngineSection(name=name, products="torch")):
            assert asked.wait(60.0 if headers else 0.0) == headers
    assert not told


def test_eager_functions_record_no_gradient() -> None:
    weight = torch.ones(3, requires_grad=True)
    assert not Engine("eager").fuse(lambda x: x * weight)(torch.ones(3)).requires_grad


def test_compiled_code_is_kept_in_the_cache_where_nobody_else_enters(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))
    # As if never set; and whatever is set meanwhile is undone.
    monkeypatch.setitem(os.environ, "TORCHINDUCTOR_CACHE_DIR", "")
    monkeypatch.delitem(os.environ, "TORCHINDUCTOR_CACHE_DIR")
    Engine("eager")
    assert "TORCHINDUCTOR_CACHE_DIR" not in os.environ
    Engine("compiled")
    assert os.environ["TORCHINDUCTOR_CACHE_DIR"] == str(compiled_root())


def updates(learner: Learner, count: int) -> list[np.ndarray]:
    """The state, as one vector, after each of `count` tuning updates by the learner's own path."""
    trainer, extent = learner._online, learner._experience.extent
    update = trainer._update(learner._begin(1).data)
    specs = learner._algorithm.noise_spec(learner.description.algorithm.batch_size)
    sample_block = trainer._sampling(specs, extent, Phase("tuning", 1, 0), "")
    sampled = to_tensors(sample_block(0, count), CPU)
    begun = learner._begin(1)
    states, state = [], {**learner._learned.state, **begun.changed}
    for index in range(count):
        state, _ = update(state, {name: array[index] for name, array in sampled.items()})
        parts = [state[name].numpy() for name in ("vae", "critic", "critic_target", "actor")]
        states.append(np.concatenate(parts))
    return states


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["otc-embedding", "otc-value", "dynamics-share", "balanced"])
def test_compiled_equals_eager(arm: str) -> None:
    """20 updates in float32: longer, and rounding grows."""
    runs = []
    for name in ("eager", "compiled"):
        size = ("algorithm.hidden=[64,64]", "algorithm.batch_size=32", "sampling.candidates=64")
        learner = brain(*ARMS[arm], *size, "offline.updates=0")
        learner.pretrain(silent, unsaved)  # eagerly: the same embedding
        compiled = brain(*ARMS[arm], *size, "offline.updates=0", f"engine.name={name}")
        if learner._fits.own and compiled._fits.own:
            compiled._fits.own.state = learner._fits.own.state
        compiled.pretrain(silent, unsaved)
        compiled._experience.merge(online(1))
        compiled._experience.embed()
        runs.append(updates(compiled, 20))
    for eager, compiled_state in zip(*runs, strict=True):
        np.testing.assert_allclose(compiled_state, eager, atol=1e-5)


@pytest.mark.slow
def test_a_process_may_compile_many_variants_and_compiles_each_once() -> None:
    """A comparison in one process: brains of many sizes and arms."""

    def variant(width: int) -> Callable[[torch.Tensor], torch.Tensor]:
        return Engine("compiled").fuse(lambda x: 2 * x + width)

    def compiled() -> int:
        return int(counters["stats"]["unique_graphs"])

    start = compiled()
    for width in range(10):  # torch's own limit is 8
        assert variant(width)(torch.ones(3)).tolist() == [2 + width] * 3
    assert compiled() == start + 10
    for width in range(10):
        variant(width)(torch.ones(3))
    assert compiled() == start + 10
    assert variant(3)(torch.ones(4)).tolist() == [5] * 4  # other shapes are never mistaken
    assert compiled() == start + 11
    headers = Path(os.environ["TORCHINDUCTOR_CACHE_DIR"], "precompiled_headers")
    assert list(headers.glob("*.h"))  # and not in a folder under /tmp that anybody may make
