"""The rows that the mechanism check selects from, and what only an analysis knows of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from otc_dist.comparison import perfect
from otc_dist.comparison.frozen_agent import FrozenAgent
from otc_dist.comparison.runs import OnProgress, restored
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.datasets import store
from otc_dist.datasets.joint import JointTransitions
from otc_dist.description import Description
from otc_dist.description.kinds import STRATEGIES
from otc_dist.learner import team
from otc_dist.learner.folds import folds
from otc_dist.otc import create_sampler
from otc_dist.otc.data import Data
from otc_dist.otc.samplers.interface import Extent, MergedData
from otc_dist.randomness import stream
from otc_dist.steps.noise import Noise, sample_noise
from otc_dist.steps.state import State
from otc_dist.steps.training import BLOCK, train
from otc_dist.transitions import Float64, Transitions


@dataclass(frozen=True)
class Pool:
    """One agent's rows: some of B_1, then all of D_1."""

    data: dict[str, Data]  # of each distance
    size: int  # rows before D_1's
    mismatch: Tensor  # (N,) l2 distance over all other agents' action components
    error: Tensor  # (N,) of s', squared, from what it would be with the others acting as now
    value: Tensor  # (N,) V(s'), not a number without a Q
    online: Tensor  # (N,) whether it is D_1's
    weights: dict[str, Tensor]  # row of the table -> (size,) how likely a strategy draws each

    def means(self, rows: Tensor) -> Float64:
        """Of `rows`: mismatch and error of s', of all and of B_0's among them, V(s'), and the share
        of D_1's; in the order of `mechanism.Selected`.
        """
        mismatch, error, online = self.mismatch[rows], self.error[rows], self.online[rows]
        offline = (mismatch[~online], error[~online])
        parts = (mismatch, offline[0], error, offline[1], self.value[rows], online.float())
        return np.array([float(part.mean()) for part in parts])


def pools(
    folder: ComparisonFolder,
    description: Description,
    frozen_agents: Sequence[FrozenAgent],
    wanted: int,
    on_progress: OnProgress,
) -> list[Pool]:
    """Each agent's rows of the same joint transitions, up to `wanted` of B_0 and D_1 together."""
    seed, dataset = description.seed, description.dataset
    on_progress(0.0, "deploying")
    online = team.deploy(restored(folder.seed(seed), description), 1)
    joint = store.load_joint(dataset.name, dataset.transitions)
    offline, count = len(joint), len(joint) + description.deployment.transitions
    size = min(wanted, count)
    chosen = stream(seed, "mechanism", "pool").choice(count, size, replace=False)
    numbers = np.concatenate([chosen, np.arange(offline, count)])
    is_online = torch.from_numpy(numbers >= offline)
    rows, halves, weights = [], [], []
    strategies = {name: row for name in STRATEGIES if (row := STRATEGIES.section(name).row)}
    for index, frozen in enumerate(frozen_agents):
        on_progress(0.1 * index / len(frozen_agents), "what samplers learn")
        before, newest = joint.of_agent(index), team.own_transitions(online, index)
        merged = frozen.rows(Transitions.concatenate([before, newest]))
        learned = {
            row: _weights(name, description, frozen, merged, offline, index)
            for name, row in strategies.items()
        }
        rows.append(merged[torch.from_numpy(numbers)])
        both = np.concatenate([folds(before), folds(newest)])
        halves.append(torch.from_numpy(both[numbers]))
        mine = torch.from_numpy(chosen)
        weights.append({row: of_all[mine] for row, of_all in learned.items()})
    gaps = []  # of each agent, (N, a)
    for index, (frozen, mine) in enumerate(zip(frozen_agents, rows, strict=True)):
        on_progress(0.1 + 0.3 * index / len(rows), "asking the policies what they would do")
        gaps.append(frozen.gap(mine, stream(seed, "mechanism", "act", index)))
    on_progress(0.4, "playing what they would do")
    everything = JointTransitions.concatenate([joint, JointTransitions.of_steps(online)])
    errors = successor_errors(description.env.id, everything[numbers], gaps)
    on_progress(0.45, "embeddings and values")
    return [
        Pool(
            frozen.data(mine, halves[index]),
            size,
            torch.from_numpy(np.linalg.norm(np.concatenate(_others(gaps, index), axis=1), axis=1)),
            errors[index],
            frozen.next_values(mine, stream(seed, "mechanism", "value", index)),
            is_online,
            weights[index],
        )
        for index, (frozen, mine) in enumerate(zip(frozen_agents, rows, strict=True))
    ]


def successor_errors(
    env_id: str, joint: JointTransitions, gaps: Sequence[NDArray[np.float32]]
) -> list[Tensor]:
    """Of each agent, the squared error (N,) of the recorded s' against the simulator's with the
    others acting as now, every component in standard deviations; not a number where the simulator
    cannot be set to a state.

    Args:
        gaps: recorded actions minus those of now, of each agent (N, a).
    """
    if not perfect.possible(env_id):
        return [torch.full((len(joint),), torch.nan) for _ in gaps]
    now = [recorded - gap for recorded, gap in zip(joint.actions, gaps, strict=True)]
    correction = perfect.Correction(perfect.OneStep(env_id), joint)
    errors = []
    for index, recorded in enumerate(joint.next_observations):
        wrong = recorded - correction.of_agent(index, now).next_observations
        wrong /= recorded.std(axis=0) + np.float32(1e-6)
        errors.append(torch.from_numpy(np.square(wrong).sum(axis=1)))
    return errors


def _others(gaps: Sequence[NDArray[np.float32]], index: int) -> list[NDArray[np.float32]]:
    return [gap for j, gap in enumerate(gaps) if j != index]


def _weights(
    name: str,
    description: Description,
    frozen: FrozenAgent,
    rows: Tensor,
    offline: int,
    agent: int,
) -> Tensor:
    """How likely a strategy draws each row of B_1 (N,), after the first deployment's L updates, in
    which it learned and the policy did not.
    """
    described = description.with_assignments(f"sampling.name={name}")
    sampler = create_sampler(frozen.setting._replace(description=described), len(rows))
    extent = Extent(offline, offline, len(rows))
    data, nothing = Data(rows, rows[:, :0]), rows.new_zeros(0)

    def random(*key: int | str) -> np.random.Generator:
        return stream(description.seed, "mechanism", name, agent, *key)

    def sample_block(block: int, count: int) -> dict[str, NDArray[np.generic]]:
        noise = sample_noise(random("noise", block), sampler.noise_spec(), count)
        return {**sampler.sample_indices(random("minibatches", block), count, extent), **noise}

    def update(state: State, sampled: Noise) -> tuple[State, Tensor]:
        selection = sampler.select(state, sampler.gather(state, data, sampled), sampled)
        return {**state, **selection.changed}, nothing

    with torch.no_grad():
        held = MergedData(frozen.state, data, extent, frozen.engine, random)
        begun = {**frozen.state, **sampler.begin(held).changed}
        span = (0, description.deployment.updates)
        learned = train(begun, update, sample_block, rows.device, span, BLOCK, _ignore)
    return sampler.weights(learned, len(rows))


def _ignore(state: State, done: int, metrics: list[float]) -> None:
    pass
