"""d_q: transitions are matched by Q(s, a) and compared by V(s') (Eq. 1)."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from otc_dist.algorithms.interface import Batch, Critic, unpack
from otc_dist.otc.data import Data
from otc_dist.otc.distances.interface import Ids, Scores, Setting
from otc_dist.otc.samplers.correction import CorrectionSection, NormaliserName, settings_of
from otc_dist.otc.samplers.interface import MergedData
from otc_dist.steps.noise import Noise, NoiseSpec, sample_noise, to_tensors
from otc_dist.steps.state import State
from otc_dist.transitions import RowLayout

GUARD = 1e-2  # a normaliser below this many standard deviations is replaced
NEIGHBOURS = 2  # looked at on each side of the insertion point: one may be the query itself
CHUNK = 8192  # rows whose values are computed at once


@dataclass(frozen=True)
class ValueDistance:
    """d_q of one agent, whose Q changes at every update."""

    critic: Critic
    layout: RowLayout
    settings: CorrectionSection

    @classmethod
    def create(cls, setting: Setting) -> "ValueDistance":
        assert setting.critic is not None  # a description without a Q does not ask for d_q
        return cls(setting.critic, setting.layout, settings_of(setting.description))

    def noise_spec(self, candidates: int) -> dict[str, NoiseSpec]:
        return dict(self.critic.value_noise_spec(candidates, self.settings.value_samples))

    def gather(self, data: Data, numbers: Tensor) -> Tensor:
        return data.rows.index_select(0, numbers)

    def between(
        self, state: State, candidates: Tensor, references: Tensor, ids: Ids | None, noise: Noise
    ) -> tuple[Tensor, Tensor]:
        batch, online = unpack(candidates, self.layout), unpack(references, self.layout)
        matches = match_values(
            self.critic.q(state, batch.observation, batch.action),
            self.critic.q(state, online.observation, online.action),
            ids,
        )
        # Both values by the same noise: less noise in their difference.
        values = self._values(state, batch.next_observation, batch.terminated, noise)
        matched = self._values(
            state, online.next_observation[matches], online.terminated[matches], noise
        )
        return next_state_distance(values, matched, self.settings.normaliser)

    def scores(self, held: MergedData, *, exclude_self: bool) -> Scores:
        """By the critics as they are now, exactly over all of B_k and D_k."""
        extent, random = held.extent, held.random("similarity")
        rows = held.data.rows[: extent.size]
        q, values = [], []
        for part in torch.split(rows, CHUNK):
            batch = unpack(part, self.layout)
            q.append(self.critic.q(held.state, batch.observation, batch.action))
            values.append(self._next_values(held.state, batch, random))
        all_q, all_values = torch.cat(q), torch.cat(values)
        ids = None
        if exclude_self:
            numbers = torch.arange(extent.size, device=rows.device)
            ids = (numbers, numbers[extent.newest :])
        matches = match_values(all_q, all_q[extent.newest :], ids)
        found, guarded = next_state_distance(
            all_values, all_values[extent.newest :][matches], self.settings.normaliser
        )
        return Scores(found, float(guarded))

    def similarity(self, held: MergedData) -> tuple[float, float]:
        """𝔻_k over all of B_k and D_k."""
        found = self.scores(held, exclude_self=self.settings.exclude_self)
        return float(found.values.double().mean()), found.guarded

    def _values(self, state: State, states: Tensor, terminated: Tensor, noise: Noise) -> Tensor:
        """V(s') (B,), 0 at a terminal s'."""
        return torch.where(terminated > 0, 0.0, self.critic.value(state, states, noise))

    def _next_values(self, state: State, batch: Batch, random: np.random.Generator) -> Tensor:
        specs = self.critic.value_noise_spec(len(batch.reward), self.settings.value_samples)
        arrays = to_tensors(sample_noise(random, specs, 1), batch.reward.device)
        noise = {name: array[0] for name, array in arrays.items()}
        return self._values(state, batch.next_observation, batch.terminated, noise)


def match_values(queries: Tensor, references: Tensor, ids: Ids | None = None) -> Tensor:
    """Index (B,) of the reference whose Q is nearest to each query's: arg min d_q (Eq. 1).

    References in random order make ties fall at random: of equally near neighbours the one that
    comes first in that order is taken.

    Args:
        queries: Q(s, a_i) (B,) of the minibatch B.
        references: Q(s, a_i) (D,) of D.
        ids: if a transition must not match itself.
    """
    values, order = references.sort(stable=True)
    insertion = torch.searchsorted(values, queries).unsqueeze(1)
    nearby = insertion + torch.arange(-NEIGHBOURS, NEIGHBOURS, device=queries.device)
    inside = (nearby >= 0) & (nearby < len(values))
    nearby = nearby.clamp(0, len(values) - 1)
    gap = (values[nearby] - queries.unsqueeze(1)).abs()
    candidates = order[nearby]
    if ids is not None:
        inside = inside & (ids[1][candidates] != ids[0].unsqueeze(1))
    gap = gap.masked_fill(~inside, torch.inf)
    tied = gap == gap.amin(1, keepdim=True)
    return candidates.masked_fill(~tied, len(values)).amin(1)


def next_state_distance(
    values: Tensor, matched: Tensor, normaliser: NormaliserName
) -> tuple[Tensor, Tensor]:
    """d_q(s', s'*) (B,) between V(s') and V(s'*) of the best matches.

    `paper`:    |V / E V - V* / E V*|, means over the transitions and over their matches
                (the paper's formula). Where the two means differ, even a perfect match is at a
                distance, which then grows with V: see the documentation.
    `shared`:   |V - V*| / |E|, one mean over both.
    `relative`: |V - V*| / |V*|.

    A normaliser near zero (less than GUARD standard deviations) is replaced by that bound.

    Returns:
        The distances, and how many normalisers were replaced (a float scalar).
    """
    if normaliser == "paper":
        mean, guarded = _guard(values.mean(), values.std())
        matched_mean, matched_guarded = _guard(matched.mean(), matched.std())
        return (values / mean - matched / matched_mean).abs(), guarded + matched_guarded
    both = torch.cat((values, matched))
    scale = both.mean() if normaliser == "shared" else matched
    scale, guarded = _guard(scale, both.std())
    return ((values - matched) / scale).abs(), guarded


def _guard(scale: Tensor, spread: Tensor) -> tuple[Tensor, Tensor]:
    bound = GUARD * spread + torch.finfo(scale.dtype).tiny
    small = scale.abs() < bound
    return torch.where(small, torch.where(scale < 0, -bound, bound), scale), small.sum().to(
        scale.dtype
    )
