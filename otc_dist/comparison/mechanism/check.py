"""What OTC selects: how far the other agents' recorded actions are from what they would do now.

Data sets are generated jointly, so an analysis, never a learner, knows the other agents' actions.
The smaller |a_-i - pi_-i(s)| is in the selected transitions, the better they follow the online
dynamics; and so they do the better, the nearer s' is to what the simulator, where it can be set to
a state, reaches with the others acting as now. Everything is reported as a ratio to uniform
sampling, so 1 is no effect.
"""

import time
from dataclasses import asdict, dataclass, fields

import numpy as np
import torch

from otc_dist.comparison.arms import of_seed
from otc_dist.comparison.frozen_agent import FrozenAgent
from otc_dist.comparison.mechanism.pool import Pool, pools
from otc_dist.comparison.mechanism.selectors import noise_spec, selectors
from otc_dist.comparison.mechanism.table import ONLINE
from otc_dist.comparison.runs import OnProgress
from otc_dist.comparison.scores import ComparisonFolder, write_json
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.otc.samplers.correction import settings_of
from otc_dist.randomness import stream
from otc_dist.steps.noise import sample_noise, to_tensors

POOL = 40_000  # rows of B_1 that minibatches come from: acting on all of B_1 would take minutes
MINIBATCHES = 200


@dataclass(frozen=True)
class Selected:
    """What one selector gave one agent, as ratios to uniform sampling from B_1."""

    mismatch: float  # of |a_-i - pi_-i(s)|
    offline: float  # the same of B_0's transitions alone, to uniform sampling from B_0
    error: float  # of |s' - s'_now|^2, by the simulator
    offline_error: float  # the same of B_0's transitions alone
    value: float  # of V(s')
    online: float  # no ratio: the share of D_1's own transitions, which match themselves


def measure(
    folder: ComparisonFolder, base: Description, seed: int, name: str, on_progress: OnProgress
) -> None:
    """Measure one seed at the first deployment, and write `folder.mechanism(name, seed)`.

    Nobody explores in it, whatever `base` says: D_1 is what the policies do.

    Raises:
        UserError: a checkpoint or the data set is missing or damaged.
    """
    start = time.monotonic()
    description = of_seed(base, seed).with_assignments("deployment.exploration=none")
    spec = registry.team_spec(base.env.id)
    files = folder.seed(seed)
    frozen_agents = [FrozenAgent(description, a, files.checkpoint(a.name, 0)) for a in spec.agents]
    held = pools(folder, description, frozen_agents, POOL, on_progress)
    found: dict[str, dict[str, Selected]] = {}
    for index, (agent, frozen, pool) in enumerate(
        zip(spec.names, frozen_agents, held, strict=True)
    ):
        on_progress(0.5 + 0.5 * index / len(held), f"minibatches of {agent}")
        for row, selected in _selected(description, frozen, pool, agent).items():
            found.setdefault(row, {})[agent] = selected
    write_json(
        folder.mechanism(name, seed),
        {
            "seed": seed,
            "pool": held[0].size,
            "minibatches": MINIBATCHES,
            "uniform_mismatch": {
                agent: float(pool.mismatch[: pool.size].mean())
                for agent, pool in zip(spec.names, held, strict=True)
            },
            "selected": {row: {a: asdict(s) for a, s in of.items()} for row, of in found.items()},
            "seconds": round(time.monotonic() - start, 1),
        },
    )


def _selected(
    description: Description, frozen: FrozenAgent, pool: Pool, agent: str
) -> dict[str, Selected]:
    """All rows of one agent, on the same minibatches."""
    sampling = settings_of(description)
    of_row, specs = selectors(description, frozen, pool), noise_spec(description, frozen)
    newest = np.arange(pool.size, len(pool.mismatch))
    sums = {row: np.zeros(len(fields(Selected))) for row in of_row}
    for number in range(MINIBATCHES):
        random = stream(description.seed, "mechanism", agent, number)
        count = min(sampling.references, len(newest))
        indices = {
            "candidates": random.integers(0, pool.size, (1, sampling.candidates)),
            "references": random.permutation(newest)[None, :count],
        }
        arrays = to_tensors({**indices, **sample_noise(random, specs, 1)}, frozen.engine.device)
        sampled = {name: array[0] for name, array in arrays.items()}
        for row, selector in of_row.items():
            with torch.no_grad():
                sums[row] += pool.means(selector(sampled))
    uniform = pool.means(torch.arange(pool.size))
    uniform[-1] = 1.0  # the share of D_1's transitions is reported as it is
    means = {row: total / MINIBATCHES for row, total in sums.items()}
    means[ONLINE] = pool.means(torch.from_numpy(newest))
    return {row: Selected(*(mean / uniform).tolist()) for row, mean in means.items()}
