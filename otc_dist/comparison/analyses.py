"""Arms that no learner can be: they look at all agents' data and policies. Ceilings, not methods.

`perfect`: values learn from transitions as they would be with the others acting as now. `oracle`:
the share of B_k that random-share draws at random is the one in which the others' recorded actions
are nearest to what they would do now. What imitates the data sees a plain sample in both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from otc_dist.comparison import perfect
from otc_dist.comparison.arms import ORACLE, PERFECT
from otc_dist.comparison.present import packed, would_do
from otc_dist.datasets import store
from otc_dist.datasets.joint import JointTransitions
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.learner.learner import Learner
from otc_dist.otc.acceptance import acceptance
from otc_dist.otc.distances.interface import Scores
from otc_dist.otc.samplers.correction import settings_of
from otc_dist.otc.samplers.interface import (
    Extent,
    Gathered,
    Indices,
    MergedData,
    Preparation,
    Sampler,
    Selection,
)
from otc_dist.otc.samplers.mixing import ImitatingAll
from otc_dist.randomness import stream
from otc_dist.spec import AgentSpec
from otc_dist.steps.noise import Noise
from otc_dist.steps.state import State
from otc_dist.transitions import Float32, JointStep

POOL = 80_000  # transitions that perfect correction plays again, drawn anew at each deployment


class Analysis(Protocol):
    """What one run of such an arm looks at."""

    def sampler(self, agent: int) -> Sampler:
        """What the learner of agent number `agent` samples by."""
        ...

    def prepare(
        self, learners: Sequence[Learner], deployment: int, steps: Sequence[JointStep]
    ) -> None:
        """Look at deployment k and at the policies that acted in it, before anybody tunes."""
        ...


def create(name: str, description: Description) -> Analysis:
    """The analysis of that name, for one run. Raises UserError without all agents' data."""
    dataset = description.dataset
    joint = store.load_joint(dataset.name, dataset.transitions)
    return _Perfect(description, joint) if name == PERFECT else _Oracle(description, joint)


@dataclass
class _Rows(Sampler):
    """Values learn from rows that are given, and what imitates from a plain sample of B_k."""

    batch_size: int
    rows: Tensor = field(default_factory=lambda: torch.empty(0))  # (n, width), of this deployment

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        shape = (updates, self.batch_size)
        return {
            "batch": random.integers(extent.size, extent.size + len(self.rows), shape),
            "plain": random.integers(0, extent.size, shape),
        }

    def begin(self, held: MergedData) -> Preparation:
        """The rows given follow after those of B_k."""
        mine = held.data.rows[: held.extent.size]
        return Preparation(held.data._replace(rows=torch.cat((mine, self.rows.to(mine.device)))))

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        return Selection(sampled["batch"], sampled["plain"])


class _Perfect:
    def __init__(self, description: Description, joint: JointTransitions) -> None:
        self._seed, self._joint = description.seed, joint
        self._simulator = perfect.OneStep(description.env.id)
        agents = registry.team_spec(description.env.id).agents
        self._samplers = [_Rows(description.algorithm.batch_size) for _ in agents]

    def sampler(self, agent: int) -> Sampler:
        return self._samplers[agent]

    def prepare(
        self, learners: Sequence[Learner], deployment: int, steps: Sequence[JointStep]
    ) -> None:
        self._joint = JointTransitions.concatenate([self._joint, JointTransitions.of_steps(steps)])
        size = len(self._joint)
        random = stream(self._seed, PERFECT, "pool", deployment)
        pool = self._joint[random.choice(size, min(POOL, size), replace=False)]
        now = _everybody(learners, pool, self._seed, PERFECT, deployment)
        correction = perfect.Correction(self._simulator, pool)
        for index, learner in enumerate(learners):
            self._samplers[index].rows = packed(learner.spec, correction.of_agent(index, now))


@dataclass
class _Known:
    """A distance with given scores."""

    values: Tensor = field(default_factory=lambda: torch.empty(0))

    def scores(self, held: MergedData, *, exclude_self: bool) -> Scores:
        return Scores(self.values.to(held.data.rows.device))


class _Oracle:
    def __init__(self, description: Description, joint: JointTransitions) -> None:
        self._seed, self._joint = description.seed, joint
        self._settings, self._batch = settings_of(description), description.algorithm.batch_size
        self._agents = registry.team_spec(description.env.id).agents
        self._distances = [_Known() for _ in self._agents]

    def sampler(self, agent: int) -> Sampler:
        accept = acceptance(self._settings.acceptance)
        chosen = accept(self._distances[agent], self._settings, self._batch)
        return ImitatingAll(chosen, self._batch)

    def prepare(
        self, learners: Sequence[Learner], deployment: int, steps: Sequence[JointStep]
    ) -> None:
        self._joint = JointTransitions.concatenate([self._joint, JointTransitions.of_steps(steps)])
        now = _everybody(learners, self._joint, self._seed, ORACLE, deployment)
        gaps = [
            _gap(spec, recorded, action)
            for spec, recorded, action in zip(self._agents, self._joint.actions, now, strict=True)
        ]
        for index, distance in enumerate(self._distances):
            others = np.concatenate([gap for j, gap in enumerate(gaps) if j != index], axis=1)
            distance.values = torch.from_numpy(np.linalg.norm(others, axis=1))


def _everybody(
    learners: Sequence[Learner], joint: JointTransitions, seed: int, name: str, deployment: int
) -> list[Float32]:
    """What each agent would do now in the states of all transitions, N x (T, a)."""
    return [
        would_do(learner, joint.observations[index], stream(seed, name, deployment, "act", index))
        for index, learner in enumerate(learners)
    ]


def _gap(spec: AgentSpec, recorded: Float32, now: Float32) -> Float32:
    """a - pi(s) (T, a) in the environment's units; of discrete actions 1 where they differ."""
    if spec.choices:
        differs: Float32 = (recorded != now).astype(np.float32)
        return differs
    return recorded - now
