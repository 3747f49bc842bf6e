"""Expected transition similarity 𝔻_k (Eq. 4), over B_k and all of D_k."""

import numpy as np
import torch
from torch import Tensor

from otc_dist.algorithms.draws import draw, to_tensors
from otc_dist.algorithms.interface import Algorithm, Batch, Critic, State, unpack
from otc_dist.description import SamplingSection
from otc_dist.otc.distances import match_values, next_state_distance
from otc_dist.otc.samplers import Data, Extent, feature_distances
from otc_dist.transitions import RowLayout

CHUNK = 8192  # rows whose values are computed at once
PAIR_CHUNK = 256  # rows compared with all of D_k at once


def expected_similarity(
    algorithm: Algorithm,
    state: State,
    data: Data,
    extent: Extent,
    layout: RowLayout,
    settings: SamplingSection,
    random: np.random.Generator,
) -> tuple[float, float]:
    """𝔻_k by the described distance, and how many normalisers were guarded."""
    if settings.distance != "value":
        return sampled_similarity(data, extent, layout, settings, random), 0.0
    assert isinstance(algorithm, Critic)  # a description without a Q does not ask for d_q
    return value_similarity(algorithm, state, data, extent, layout, settings, random)


def sampled_similarity(
    data: Data,
    extent: Extent,
    layout: RowLayout,
    settings: SamplingSection,
    random: np.random.Generator,
) -> float:
    """𝔻_k by d_e or d_c: the mean distance over a sample of B_k, matched against all of D_k.

    The sample has the same size at every k, so that 𝔻_k / 𝔻_{k-1} compares like with like.
    """
    count = min(settings.similarity_sample, extent.offline)
    chosen = torch.from_numpy(random.choice(extent.size, count, replace=False))
    chosen = chosen.to(data.embeddings.device)
    online = torch.arange(extent.newest, extent.size, device=chosen.device)
    references = data.embeddings[online]
    total = 0.0
    for part in torch.split(chosen, PAIR_CHUNK):
        ids = (part, online) if settings.exclude_self else None
        distances = feature_distances(settings, layout, data.embeddings[part], references, ids)
        total += float(distances.double().sum())
    return total / count


def value_similarity(
    critic: Critic,
    state: State,
    data: Data,
    extent: Extent,
    layout: RowLayout,
    settings: SamplingSection,
    random: np.random.Generator,
) -> tuple[float, float]:
    """𝔻_k by d_q, exactly over all of B_k and D_k, and how many normalisers were guarded."""
    rows = data.rows[: extent.size]
    q, values = [], []
    for part in torch.split(rows, CHUNK):
        batch = unpack(part, layout)
        q.append(critic.q(state, batch.observation, batch.action))
        values.append(_next_values(critic, state, batch, settings.value_samples, random))
    all_q, all_values = torch.cat(q), torch.cat(values)
    ids = None
    if settings.exclude_self:
        numbers = torch.arange(extent.size, device=rows.device)
        ids = (numbers, numbers[extent.newest :])
    matches = match_values(all_q, all_q[extent.newest :], ids)
    distances, guarded = next_state_distance(
        all_values, all_values[extent.newest :][matches], settings.normaliser
    )
    return float(distances.double().mean()), float(guarded)


def _next_values(
    critic: Critic, state: State, batch: Batch, samples: int, random: np.random.Generator
) -> Tensor:
    """V(s') (B,), 0 at a terminal s'."""
    wanted = critic.value_noise(len(batch.reward), samples)
    noise = to_tensors(draw(random, wanted, 1), batch.reward.device)
    noise = {name: array[0] for name, array in noise.items()}
    values = critic.value(state, batch.next_observation, noise)
    return torch.where(batch.terminated > 0, 0.0, values)
