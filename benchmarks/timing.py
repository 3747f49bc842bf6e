"""Taking turns: what the benchmarks of updates have in common.

All variants take turns of UPDATES updates, round after round, on one thread. A time is the
processor's for this process, so that other load on the machine counts little (a GPU's is the
wall's); a ratio is that of the same round.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from otc_dist.description import Description
from otc_dist.description.algorithms import AlgorithmSection
from otc_dist.description.kinds import ALGORITHMS
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

if TYPE_CHECKING:  # memory is counted from before torch's import
    from otc_dist.learner.learner import Learner, Progress

UPDATES = 80  # a turn
ENVS = {False: "hopper-3x1", True: "5m_vs_6m"}  # whose agents' sizes: by whether discrete
OFFLINE = {"hopper-3x1": 402_000, "5m_vs_6m": 234_224}  # |B_0| of medium-replay, and of medium
ONLINE = 4_020  # M of Hopper's medium-replay

Turn = Callable[[int], float]  # milliseconds an update, of turn number 1, 2, ...


@dataclass
class Timed:
    """One variant and its milliseconds an update, round by round."""

    name: str
    turn: Turn
    times: list[float] = field(default_factory=list)

    @property
    def median(self) -> float:
        return float(np.median(self.times))

    @property
    def best(self) -> float:
        return min(self.times)

    def times_as_slow_as(self, other: "Timed") -> float:
        """The median over rounds of this time by `other`'s."""
        return float(np.median(np.divide(self.times, other.times)))


def interleave(rows: Sequence[Timed], rounds: int) -> None:
    """`rounds` turns of every row after one to warm up, with a line of progress."""
    for number in range(1, rounds + 2):
        for row in rows:
            turn = f"round {number - 1} of {rounds}" if number > 1 else "warming up"
            say(f"{turn}: {row.name.strip()}")
            milliseconds = row.turn(number)
            if number > 1:
                row.times.append(milliseconds)
    say("")


def repeated(update: Callable[[], object], times: int = UPDATES) -> Turn:
    """Turns of a peer's `update`, which makes UPDATES updates if it is called so many times."""

    def turn(number: int) -> float:
        start = time.process_time()
        for _ in range(times):
            update()
        return (time.process_time() - start) * 1e3 / UPDATES

    return turn


def tuning(learner: "Learner", online: Transitions) -> Turn:
    """Turns of `Learner.tune`: the updates of a deployment, and the improvements if the algorithm
    makes any, without what comes before and after.

    All of it: numbers drawn in bulk, gathers, sampling, update, metrics.
    """
    whole = deployment(learner, online)
    return lambda number: whole(number)[1]


def deployment(learner: "Learner", online: Transitions) -> Callable[[int], tuple[float, float]]:
    """Turns of `Learner.tune`: milliseconds of what it does before the updates of a deployment
    (merging, fitting and scoring), and milliseconds an update as `tuning` has it.
    """
    clock = _clock(learner)

    def turn(number: int) -> tuple[float, float]:
        marks: dict[int, float] = {}

        def report(progress: "Progress") -> None:
            marks[progress.update] = clock()

        start = clock()
        learner.tune(number, online, report)
        updates = (marks[max(marks)] - marks[0]) * 1e3 / UPDATES
        return (marks[0] - start) * 1e3, updates

    return turn


def at_once(learners: "Sequence[Learner]") -> Turn:
    """Turns of `train_together`, UPDATES offline updates of several seeds: what one seed's take."""
    from otc_dist.learner.together import train_together

    clock = _clock(learners[0])

    def turn(number: int) -> float:
        for learner in learners:
            learner.take_over(learner.policy[1], 0)
        start = clock()
        train_together(learners, lambda progress: None, lambda: None)
        return (clock() - start) * 1e3 / UPDATES / len(learners)

    return turn


def _clock(learner: "Learner") -> Callable[[], float]:
    gpu = learner.description.engine.name == "cuda-graph"
    return time.perf_counter if gpu else time.process_time


def sections() -> dict[str, type[AlgorithmSection]]:
    """The description's section of every algorithm, by name."""
    return {name: ALGORITHMS.section(name) for name in ALGORITHMS}


def describe(env_id: str, rounds: int, *assignments: str) -> Description:
    """A learner's description for `rounds` turns by `tuning`, after one to warm up."""
    data: dict[str, object] = {
        "name": "benchmark",
        "env": {"id": env_id},
        "dataset": {"name": f"{env_id}/random"},
    }
    return Description.build(
        data,
        (
            "offline.updates=0",
            "embedding.updates=1",
            "dynamics.updates=1",
            "embedding.minimum_active=0",
            "sampling.similarity_sample=64",  # measured before the updates, not timed
            f"deployment.count={rounds + 1}",
            f"deployment.transitions={ONLINE}",
            f"deployment.updates={UPDATES}",
            *assignments,
        ),
    )


def random_data(spec: AgentSpec, count: int, seed: int) -> Transitions:
    """Random transitions of an agent's sizes, which cost what real ones do."""
    random = np.random.default_rng(seed)
    s = random.standard_normal((2, count, spec.observation_size), np.float32)
    states, next_states = s[0], s[0] + np.float32(0.1) * s[1]
    actions = random.uniform(-1, 1, (count, spec.action_size)).astype(np.float32)
    if spec.choices:
        actions = random.integers(spec.choices, size=(count, 1)).astype(np.float32)
        states[:, -spec.choices :] = next_states[:, -spec.choices :] = 1  # all are available
    return Transitions(
        observations=states,
        actions=actions,
        rewards=1 + random.standard_normal(count, np.float32),
        next_observations=next_states,
        terminated=random.random(count) < 0.01,
        truncated=np.zeros(count, np.bool_),
    )


def say(text: str) -> None:
    """One line of progress, overwritten by the next, where there is a terminal."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
