"""What OTC selects: how far the other agents' recorded actions are from what they would do now.

Data sets are generated jointly, so an analysis, never a learner, knows the other agents' actions.
The smaller |a_-i - pi_-i(s)| is in the selected transitions, the better they follow the online
dynamics. Everything is told as a ratio to uniform sampling, so 1 is no effect.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import torch
from torch import Tensor

from otc_dist import team
from otc_dist.algorithms.draws import Draws, draw, to_tensors
from otc_dist.algorithms.interface import unpack
from otc_dist.comparison.arms import of_seed
from otc_dist.comparison.mechanism_table import ONLINE, ORACLE, ROWS, UNIFORM
from otc_dist.comparison.runs import Tell, restored
from otc_dist.comparison.scores import ComparisonFolder, write_json
from otc_dist.comparison.specimen import Specimen
from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.otc.prioritization import prioritize
from otc_dist.otc.samplers import Data, Otc
from otc_dist.randomness import stream
from otc_dist.transitions import Float64, RowLayout, Transitions

POOL = 40_000  # rows of B_1 that minibatches come from: acting on all of B_1 would take minutes
MINIBATCHES = 200


@dataclass(frozen=True)
class Selected:
    """What one way of selecting gave one agent, as ratios to uniform sampling from B_1."""

    mismatch: float  # of |a_-i - pi_-i(s)|
    offline: float  # the same of B_0's transitions alone, to uniform sampling from B_0
    value: float  # of V(s')
    online: float  # no ratio: the share of D_1's own transitions, which match themselves


@dataclass(frozen=True)
class Pool:
    """One agent's rows: POOL of B_1, then all of D_1, and what only the analysis knows of them."""

    data: Data
    size: int  # rows before D_1's
    mismatch: Tensor  # (N,) l2 distance over all other agents' action components
    value: Tensor  # (N,) V(s')
    online: Tensor  # (N,) whether it is D_1's

    def means(self, rows: Tensor) -> Float64:
        """Of `rows`: mismatch, mismatch of B_0's among them, V(s'), and the share of D_1's."""
        mismatch, online = self.mismatch[rows], self.online[rows]
        offline = mismatch[~online]
        parts = (mismatch, offline, self.value[rows], online.float())
        return np.array([float(part.mean()) for part in parts])


Distances = Callable[[Draws], Tensor]  # of the candidates (B,) of one minibatch


def measure(folder: ComparisonFolder, base: Description, seed: int, name: str, tell: Tell) -> None:
    """Measure one seed at the first deployment, and write `folder.mechanism(name, seed)`.

    Raises:
        UserError: a checkpoint or the data set is missing or damaged.
    """
    start = time.monotonic()
    description = of_seed(base, seed)
    spec = registry.team_spec(base.env.id)
    files = folder.seed(seed)
    specimens = [Specimen(description, a, files.checkpoint(a.name, 0)) for a in spec.agents]
    pools = _pools(folder, description, specimens, tell)
    found: dict[str, dict[str, Selected]] = {row: {} for row in ROWS}
    for index, (agent, specimen, pool) in enumerate(zip(spec.names, specimens, pools, strict=True)):
        tell(0.5 + 0.5 * index / len(pools), f"minibatches of {agent}")
        for row, selected in _selected(description, specimen, pool, agent).items():
            found[row][agent] = selected
    write_json(
        folder.mechanism(name, seed),
        {
            "seed": seed,
            "pool": pools[0].size,
            "minibatches": MINIBATCHES,
            "uniform_mismatch": {
                agent: float(pool.mismatch[: pool.size].mean())
                for agent, pool in zip(spec.names, pools, strict=True)
            },
            "selected": {row: {a: asdict(s) for a, s in of.items()} for row, of in found.items()},
            "seconds": round(time.monotonic() - start, 1),
        },
    )


def _pools(
    folder: ComparisonFolder,
    description: Description,
    specimens: Sequence[Specimen],
    tell: Tell,
) -> list[Pool]:
    """Each agent's rows of the same joint transitions, B_0 and D_1 together."""
    seed, dataset = description.seed, description.dataset
    tell(0.0, "deploying")
    online = team.deploy(restored(folder, description), 1)
    joint = store.load_joint(dataset.name, dataset.transitions)
    count = len(joint) + description.deployment.transitions
    size = min(POOL, count)
    chosen = stream(seed, "mechanism", "pool").choice(count, size, replace=False)
    is_online = torch.ones(size + description.deployment.transitions, dtype=torch.bool)
    is_online[:size] = torch.from_numpy(chosen >= len(joint))
    rows = []
    for index, specimen in enumerate(specimens):
        newest = team.own_transitions(online, index)
        merged = Transitions.concatenate([joint.of_agent(index), newest])
        rows.append(specimen.rows(Transitions.concatenate([merged[chosen], newest])))
    gaps = []  # of each agent: a_j - pi_j(s), (N, a)
    for index, (specimen, mine) in enumerate(zip(specimens, rows, strict=True)):
        tell(0.4 * index / len(rows), "asking the policies what they would do")
        random = stream(seed, "mechanism", "act", index)
        gaps.append(specimen.recorded(mine) - specimen.act(mine, random))
    pools = []
    for index, (specimen, mine) in enumerate(zip(specimens, rows, strict=True)):
        tell(0.4, "embeddings and values")
        others = np.concatenate([gap for j, gap in enumerate(gaps) if j != index], axis=1)
        mismatch = torch.from_numpy(np.linalg.norm(others, axis=1))
        value = specimen.next_values(mine, stream(seed, "mechanism", "value", index))
        data = Data(mine, specimen.embeddings(mine))
        pools.append(Pool(data, size, mismatch, value, is_online))
    return pools


def _selected(
    description: Description, specimen: Specimen, pool: Pool, agent: str
) -> dict[str, Selected]:
    """All rows of one agent, on the same minibatches."""
    sampling, batch = description.sampling, description.algorithm.batch_size
    ways = _ways(description, specimen, pool)
    assert specimen.critic is not None
    wanted = {
        **specimen.critic.value_noise(sampling.candidates, sampling.value_samples),
        **Otc(specimen.critic, specimen.layout, sampling, batch).noise(),
    }
    alpha = torch.tensor(sampling.alpha, dtype=torch.float32)
    newest = np.arange(pool.size, len(pool.mismatch))
    sums = {row: np.zeros(4) for row in ways}
    for number in range(MINIBATCHES):
        random = stream(description.seed, "mechanism", agent, number)
        count = min(sampling.references, len(newest))
        indices = {
            "candidates": random.integers(0, pool.size, (1, sampling.candidates)),
            "references": random.permutation(newest)[None, :count],
        }
        noise = to_tensors({**indices, **draw(random, wanted, 1)}, pool.data.rows.device)
        draws = {name: array[0] for name, array in noise.items()}
        for row, distances in ways.items():
            with torch.no_grad():
                positions = prioritize(
                    distances(draws),
                    alpha,
                    draws["priority"],
                    batch,
                    with_replacement=sampling.with_replacement,
                )
            sums[row] += pool.means(draws["candidates"][positions])
    uniform = pool.means(torch.arange(pool.size))
    uniform[-1] = 1.0  # the share of D_1's transitions is told as it is
    means = {row: total / MINIBATCHES for row, total in sums.items()}
    means[ONLINE] = pool.means(torch.from_numpy(newest))
    return {row: Selected(*(mean / uniform).tolist()) for row, mean in means.items()}


def _ways(description: Description, specimen: Specimen, pool: Pool) -> dict[str, Distances]:
    """Row -> the distances by which it ranks a minibatch."""

    def otc(*assignments: str) -> Distances:
        section = description.with_assignments(*assignments).sampling
        sampler = Otc(specimen.critic, specimen.layout, section, description.algorithm.batch_size)

        def distances(draws: Draws) -> Tensor:
            gathered = sampler.gather(specimen.state, pool.data, draws)
            return sampler.distances(specimen.state, gathered, draws)[0]

        return distances

    value = "sampling.distance=value"
    pairs, successors = _standardised(pool, specimen.layout)

    def gaps(draws: Draws) -> Tensor:
        return torch.cdist(pairs[draws["candidates"]], pairs[draws["references"]])

    def raw(draws: Draws) -> Tensor:
        matched = draws["references"][gaps(draws).argmin(dim=1)]
        difference = successors[draws["candidates"]] - successors[matched]
        return difference.square().sum(dim=1)

    return {
        "d_e": otc("sampling.distance=embedding"),
        "d_q, paper": otc(value, "sampling.normaliser=paper"),
        "d_q, shared": otc(value, "sampling.normaliser=shared"),
        "d_q, relative": otc(value, "sampling.normaliser=relative"),
        "raw (s, a) match, raw s'": raw,
        "nearness in (s, a) alone": lambda draws: gaps(draws).amin(dim=1),
        # All at the same distance in a random order: uniform.
        UNIFORM: lambda draws: torch.zeros(len(draws["candidates"])),
        ORACLE: lambda draws: pool.mismatch[draws["candidates"]],
    }


def _standardised(pool: Pool, layout: RowLayout) -> tuple[Tensor, Tensor]:
    """(s, a) and s' of all rows, each component standardised over the pool."""
    batch = unpack(pool.data.rows, layout)
    states, actions = batch.observation[: pool.size], batch.action[: pool.size]
    state_std, state_mean = torch.std_mean(states, dim=0)
    action_std, action_mean = torch.std_mean(actions, dim=0)
    pairs = torch.cat(
        [
            (batch.observation - state_mean) / (state_std + 1e-3),
            (batch.action - action_mean) / (action_std + 1e-3),
        ],
        dim=1,
    )
    return pairs, (batch.next_observation - state_mean) / (state_std + 1e-3)
