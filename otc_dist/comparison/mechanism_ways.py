"""The ways of selecting that the mechanism check holds against each other."""

from collections.abc import Callable

import torch
from torch import Tensor

from otc_dist.algorithms.draws import Draw, Draws
from otc_dist.algorithms.interface import action_features, unpack
from otc_dist.comparison.mechanism_pool import Pool
from otc_dist.comparison.mechanism_table import BALANCED, ORACLE, UNIFORM
from otc_dist.comparison.specimen import Specimen
from otc_dist.description import Description
from otc_dist.otc import priorities
from otc_dist.otc.prioritization import prioritize
from otc_dist.otc.samplers import Otc
from otc_dist.transitions import RowLayout

Way = Callable[[Draws], Tensor]  # selected rows (batch,) of the pool, from one minibatch's draws
Distances = Callable[[Draws], Tensor]  # of the candidates (B,) of one minibatch

_NORMALISERS = ("paper", "shared", "relative")


def ways(description: Description, specimen: Specimen, pool: Pool) -> dict[str, Way]:
    """Row of the table -> how it selects. Without a Q there is no d_q."""
    sampling, batch = description.sampling, description.algorithm.batch_size
    alpha = torch.tensor(sampling.alpha, dtype=torch.float32)

    def ranked(distances: Distances) -> Way:
        """By Eq. 3 at alpha_0, on the same candidates and by the same noise as all others."""

        def rows(draws: Draws) -> Tensor:
            positions = prioritize(
                distances(draws),
                alpha,
                draws["priority"],
                batch,
                with_replacement=sampling.with_replacement,
            )
            return draws["candidates"][positions]

        return rows

    def otc(*assignments: str) -> Way:
        section = description.with_assignments(*assignments).sampling
        sampler = Otc(specimen.critic, specimen.layout, section, batch)

        def distances(draws: Draws) -> Tensor:
            gathered = sampler.gather(specimen.state, pool.data, draws)
            return sampler.distances(specimen.state, gathered, draws)[0]

        return ranked(distances)

    pairs, successors = _standardised(pool, specimen.layout)

    def gaps(draws: Draws) -> Tensor:
        return torch.cdist(pairs[draws["candidates"]], pairs[draws["references"]])

    def raw(draws: Draws) -> Tensor:
        matched = draws["references"][gaps(draws).argmin(dim=1)]
        difference = successors[draws["candidates"]] - successors[matched]
        return difference.square().sum(dim=1)

    held = priorities.of(pool.priorities)
    values = {
        f"d_q, {name}": otc("sampling.distance=value", f"sampling.normaliser={name}")
        for name in (_NORMALISERS if specimen.critic else ())
    }
    return {
        "d_e": otc("sampling.distance=embedding"),
        **values,
        BALANCED: lambda draws: priorities.choose(*held, draws["balanced"]),
        "raw (s, a) match, raw s'": ranked(raw),
        "nearness in (s, a) alone": ranked(lambda draws: gaps(draws).amin(dim=1)),
        # All at the same distance in a random order: uniform.
        UNIFORM: ranked(lambda draws: torch.zeros(len(draws["candidates"]))),
        ORACLE: ranked(lambda draws: pool.mismatch[draws["candidates"]]),
    }


def noise(description: Description, specimen: Specimen) -> dict[str, Draw]:
    """The random arrays that all ways need for one minibatch."""
    sampling, batch = description.sampling, description.algorithm.batch_size
    wanted: dict[str, Draw] = {}
    if specimen.critic:
        wanted.update(specimen.critic.value_noise(sampling.candidates, sampling.value_samples))
    wanted |= Otc(specimen.critic, specimen.layout, sampling, batch).noise()
    return wanted | {"balanced": Draw("uniform", (batch,))}


def _standardised(pool: Pool, layout: RowLayout) -> tuple[Tensor, Tensor]:
    """(s, a) and s' of all rows, each component standardised over the pool."""
    batch = unpack(pool.data.rows, layout)
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
