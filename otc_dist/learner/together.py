"""The offline updates of one agent under several seeds, each for all of them at once.

A single small update leaves a GPU idle. Every seed keeps its random numbers: its minibatches and
noise are those that it would draw alone, and its states are equal to those up to rounding, which
grows as it does between two engines.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby, product

import numpy as np
from numpy.typing import NDArray

from otc_dist.learner.learner import SAVE_EVERY, Learner
from otc_dist.learner.trainer import Progress, Report, check_finite
from otc_dist.steps.stacking import stack, unstack
from otc_dist.steps.state import State
from otc_dist.steps.training import BLOCK, train


def train_together(learners: Sequence[Learner], report: Report, save: Callable[[], None]) -> None:
    """Make the offline updates that are left; what comes after them is `Learner.pretrain`'s.

    Learners that an interruption has left at different updates are trained by these.

    Args:
        learners: of one agent, whose descriptions differ by the seed alone.
        report: told what one learner's would be, with the metrics of all by seed and name.
        save: called every SAVE_EVERY updates, and after the last, when all learners hold theirs.

    Raises:
        UserError: training has diverged for one of the seeds.
        ValueError: the rows that they learn from depend on the seed.
    """
    if any(learner.description.offline.rows != "all" for learner in learners):
        raise ValueError("learners that choose their rows are trained one by one")

    def reached(learner: Learner) -> int:
        return learner.offline[1].span[0]

    for _, group in groupby(sorted(learners, key=reached), reached):
        _train(list(group), report, save)


def _train(learners: Sequence[Learner], report: Report, save: Callable[[], None]) -> None:
    trainers, works = zip(*(learner.offline for learner in learners), strict=True)
    blocks = [trainer.sampling(work) for trainer, work in zip(trainers, works, strict=True)]
    trainer, work = trainers[0], works[0]
    seeds = tuple(learner.description.seed for learner in learners)
    names = [f"seed {seed}'s {name}" for seed, name in product(seeds, trainer.metric_names)]

    def sample_block(block: int, count: int) -> Mapping[str, NDArray[np.generic]]:
        sampled = [of_seed(block, count) for of_seed in blocks]
        return {name: np.stack([one[name] for one in sampled], axis=1) for name in sampled[0]}

    def on_updates(state: State, done: int, metrics: list[float]) -> None:
        named = dict(zip(names, metrics, strict=True))
        check_finite(work.phase, done, named.items())
        if done % SAVE_EVERY == 0 or done == work.span[1]:
            for learner, own in zip(learners, unstack(state), strict=True):
                learner.take_over(own, done, seeds)
            save()
        report(Progress("offline", 0, done, work.span[1], named))

    train(
        stack([one.state for one in works]),
        trainer.stacked_update(work.data),
        sample_block,
        trainer.device,
        work.span,
        BLOCK,
        on_updates,
    )
