"""The selectors of transitions that the mechanism check compares."""

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from torch import Tensor

from otc_dist.algorithms.interface import action_features, unpack
from otc_dist.comparison.frozen_agent import FrozenAgent
from otc_dist.comparison.mechanism.pool import Pool
from otc_dist.comparison.mechanism.table import ORACLE, UNIFORM
from otc_dist.description import Description
from otc_dist.description.distances import DISTANCES
from otc_dist.otc.acceptance import rank
from otc_dist.otc.distances import create_distance
from otc_dist.otc.prioritization import prioritize
from otc_dist.otc.samplers import priorities
from otc_dist.otc.samplers.correction import settings_of
from otc_dist.otc.samplers.interface import Extent, MergedData
from otc_dist.randomness import stream
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.transitions import RowLayout

Selector = Callable[[Noise], Tensor]  # what a minibatch sampled -> selected rows (batch,)
Distances = Callable[[Noise], Tensor]  # of the candidates (B,) of one minibatch

BEST = 0.1  # of the pool
TENTH = "best tenth"
_OTC = ("sampling.name=otc", "sampling.acceptance=rank", "sampling.matching=minibatch")


def selectors(description: Description, frozen: FrozenAgent, pool: Pool) -> dict[str, Selector]:
    """Row of the table -> how it selects. Without a Q there is no d_q."""
    sampling, batch = settings_of(description), description.algorithm.batch_size
    alpha = torch.tensor(sampling.alpha, dtype=torch.float32)

    def ranked(distances: Distances) -> Selector:
        """By Eq. 3 at alpha_0, on the same candidates and by the same noise as all others."""

        def rows(sampled: Noise) -> Tensor:
            positions = prioritize(
                distances(sampled),
                alpha,
                sampled["priority"],
                batch,
                with_replacement=sampling.with_replacement,
            )
            return sampled["candidates"][positions]

        return rows

    def within(name: str, assignments: Sequence[str]) -> Selector:
        """By distances within a minibatch, as Algorithm 1 has it."""
        described = description.with_assignments(*_OTC, f"sampling.distance={name}", *assignments)
        setting = frozen.setting._replace(description=described)
        sampler = rank.create(create_distance(name, setting), settings_of(described), batch)
        assert isinstance(sampler, rank.RankMatched)

        def distances(sampled: Noise) -> Tensor:
            pairs = sampler.pairs(pool.data[name], sampled)
            return sampler.distances(frozen.state, pairs, sampled)[0]

        return ranked(distances)

    pairs, successors = _standardised(pool, frozen.layout)

    def gaps(sampled: Noise) -> Tensor:
        return torch.cdist(pairs[sampled["candidates"]], pairs[sampled["references"]])

    def raw(sampled: Noise) -> Tensor:
        matched = sampled["references"][gaps(sampled).argmin(dim=1)]
        difference = successors[sampled["candidates"]] - successors[matched]
        return difference.square().sum(dim=1)

    found: dict[str, Selector] = {}
    for name, facts in DISTANCES.items():
        if facts.needs_q and not frozen.critic:
            continue
        if facts.per_update:
            for title, assignments in (facts.rows or {facts.title: ()}).items():
                found[title] = within(name, assignments)
        scores = _scores(description, frozen, pool, name)
        if not facts.per_update:
            found[facts.title] = ranked(partial(_looked_up, scores))
        best = scores.argsort(stable=True)[: math.ceil(BEST * pool.size)]
        found[f"{facts.title}, {TENTH}"] = partial(_any_of, best)
    nearest = pool.mismatch[: pool.size].argsort(stable=True)[: math.ceil(BEST * pool.size)]
    for row, weights in pool.weights.items():
        found[row] = partial(_by_priority, priorities.of(weights))
    return found | {
        "raw (s, a) match, raw s'": ranked(raw),
        "nearness in (s, a) alone": ranked(lambda sampled: gaps(sampled).amin(dim=1)),
        # All at the same distance in a random order: uniform.
        UNIFORM: ranked(lambda sampled: torch.zeros(len(sampled["candidates"]))),
        ORACLE: ranked(lambda sampled: pool.mismatch[sampled["candidates"]]),
        f"{ORACLE}, {TENTH}": partial(_any_of, nearest),
    }


def _looked_up(scores: Tensor, sampled: Noise) -> Tensor:
    return scores[sampled["candidates"]]


def _by_priority(held: tuple[Tensor, Tensor], sampled: Noise) -> Tensor:
    return priorities.choose(*held, sampled["part"])


def _any_of(rows: Tensor, sampled: Noise) -> Tensor:
    """As many of `rows` as a batch has, each as likely as another."""
    return rows[(sampled["part"] * len(rows)).long()]


def _scores(description: Description, frozen: FrozenAgent, pool: Pool, name: str) -> Tensor:
    """Scores (size,) of the pool's rows, by all of D_1."""

    def random(*key: int | str) -> np.random.Generator:
        return stream(description.seed, "mechanism", "scores", name, *key)

    data, size = pool.data[name], pool.size
    extent = Extent(size, size, len(data.rows))
    held = MergedData(frozen.state, data, extent, frozen.engine, random)
    with torch.no_grad():
        return create_distance(name, frozen.setting).scores(held, exclude_self=False).values[:size]


def noise_spec(description: Description, frozen: FrozenAgent) -> dict[str, NoiseSpec]:
    """The random arrays that all selectors need for one minibatch."""
    sampling, batch = settings_of(description), description.algorithm.batch_size
    specs: dict[str, NoiseSpec] = {}
    if frozen.critic:
        specs.update(frozen.critic.value_noise_spec(sampling.candidates, sampling.value_samples))
    priority = {"priority": NoiseSpec("exponential", (sampling.candidates,))}
    return specs | priority | {"part": NoiseSpec("uniform", (batch,))}


def _standardised(pool: Pool, layout: RowLayout) -> tuple[Tensor, Tensor]:
    """(s, a) and s' of all rows, each component standardised over the pool."""
    batch = unpack(pool.data["random"].rows, layout)
    actions = action_features(batch.action, layout.choices)
    state_std, state_mean = torch.std_mean(batch.observation[: pool.size], dim=0)
    action_std, action_mean = torch.std_mean(actions[: pool.size], dim=0)
    pairs = torch.cat(
        [
            (batch.observation - state_mean) / (state_std + 1e-3),
            (actions - action_mean) / (action_std + 1e-3),
        ],
        dim=1,
    )
    return pairs, (batch.next_observation - state_mean) / (state_std + 1e-3)
