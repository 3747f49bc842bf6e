"""Every update can be recorded as a CUDA graph, as far as that shows without a GPU.

The meta device stands for the GPU. Its tensors have shapes and no numbers, so an operation that
would stop a GPU to read one fails.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map_only

from otc_dist.learner.learner import Learner
from otc_dist.learner.trainer import Phase
from otc_dist.otc.distances.embedding import Embedder
from otc_dist.steps.engine import Engine
from otc_dist.steps.noise import to_tensors
from otc_dist.steps.stacking import stack
from otc_dist.steps.state import P, T

from ..algorithms import every
from ..brains import ARMS, silent

CPU, GPU = torch.device("cpu"), torch.device("meta")
HAS_Q = {name: section.has_q for name, section in every.SECTIONS.items()}
PAIRS = {(name, "otc-value" if has_q else "otc-embedding") for name, has_q in HAS_Q.items()}
PAIRS |= {("bcq", arm) for arm in ARMS}


class Recording(TorchDispatchMode):
    """Refuses tensors that lie elsewhere: a graph would read the same old ones at each replay."""

    def __torch_dispatch__(
        self,
        func: Any,
        types: Any,
        args: Sequence[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        found = func(*args, **(kwargs or {}))
        for leaf in tree_leaves((args, kwargs, found)):
            assert not isinstance(leaf, Tensor) or leaf.device == GPU, func
        return found


def on_gpu(tensors: Any) -> Any:
    return tree_map_only(Tensor, lambda tensor: tensor.to(GPU), tensors)


def record(update: Callable[[], tuple[Mapping[str, Tensor], Tensor]]) -> Mapping[str, Tensor]:
    with torch.no_grad(), Recording():
        state, _ = update()
    return state


def kinds(state: Mapping[str, Tensor]) -> dict[str, tuple[torch.Size, torch.dtype]]:
    return {key: (tensor.shape, tensor.dtype) for key, tensor in state.items()}


def tuned(name: str, *assignments: str) -> Learner:
    learner = every.pretrained(name, *assignments)
    learner.tune(1, every.online(name, 1), silent)
    return learner


@pytest.mark.parametrize(("name", "arm"), sorted(PAIRS))
def test_an_update_stays_on_the_gpu(name: str, arm: str) -> None:
    learner = tuned(name, *ARMS[arm])
    trainer, experience = learner._online, learner._experience
    specs = learner._algorithm.noise_spec(every.BATCH)
    sample_block = trainer._sampling(specs, experience.extent, Phase("tuning", 1, 0), "")
    arrays = to_tensors(sample_block(0, 1), CPU)
    sampled = on_gpu({key: array[0] for key, array in arrays.items()})
    state, update = on_gpu(learner.policy[1]), trainer._update(on_gpu(learner._begin(1).data))
    new = record(lambda: update(state, sampled))
    assert kinds(new) == kinds(state)  # the next replay reads what this one has written


class Traced(Engine):
    """Follows functions as a compiler does, which must find no branch that depends on numbers."""

    def fuse(self, function: Callable[P, T]) -> Callable[P, T]:
        compiled: Callable[P, T] = torch.compile(function, backend="eager", fullgraph=True)
        return torch.no_grad()(compiled)


def test_an_update_of_several_seeds_stays_on_the_gpu() -> None:
    """That of the algorithm which on a CPU has a branch."""
    trainer, work = every.brain("td3bc").offline
    arrays = to_tensors(trainer.sampling(work)(0, 1), CPU)
    one = {key: array[0] for key, array in arrays.items()}
    state, sampled = (on_gpu(stack([tensors] * 3)) for tensors in (work.state, one))
    trainer._engine = Traced("eager")
    new, metrics = trainer.stacked_update(on_gpu(work.data))(state, sampled)
    assert kinds(new) == kinds(state) and {x.device for x in new.values()} == {GPU}
    assert metrics.shape == (3 * len(trainer.metric_names),)


def test_an_update_of_the_embedding_stays_on_the_gpu() -> None:
    learner, trial = tuned("bcq", *ARMS["otc-embedding"]), every.Trial("bcq")
    embedder = learner._fits.own
    assert isinstance(embedder, Embedder) and embedder.state
    embedding = embedder._embedding
    state, batch = on_gpu(embedder.state), on_gpu(trial.batch)
    sampled = on_gpu(trial.noise(embedding.noise_spec(every.BATCH)))
    record(lambda: embedding.update(state, batch, sampled))


def test_what_a_graph_cannot_hold_is_noticed() -> None:
    number = torch.ones((), device=GPU)
    with pytest.raises(RuntimeError, match="meta"):
        record(lambda: ({}, number if number > 0 else -number))
    with pytest.raises(AssertionError):
        record(lambda: ({}, number + torch.tensor(1.0)))
