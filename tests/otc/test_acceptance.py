"""Which transitions are accepted, given their scores: by share and by conformal p-values."""

from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats

from otc_dist.otc.acceptance import acceptance as rule
from otc_dist.otc.acceptance import conformal, share
from otc_dist.otc.data import Data
from otc_dist.otc.distances.interface import Scores
from otc_dist.otc.samplers.correction import CorrectionSection
from otc_dist.otc.samplers.interface import Extent, MergedData
from otc_dist.otc.samplers.uniform import UniformSection

from .held import held_by

EXTENT = Extent(offline=900, newest=950, size=1000)
BATCH = 64


class Given:
    """Scores that the test gives; those of D_k as if they were not there are 10 higher."""

    def __init__(self, scores: np.ndarray) -> None:
        self.values = torch.from_numpy(scores)

    def scores(self, held: MergedData, *, exclude_self: bool) -> Scores:
        values = self.values.clone()
        if exclude_self:
            values[EXTENT.newest :] += 10
        return Scores(values)


def drawn(acceptance: str, scores: np.ndarray, **settings: Any) -> np.ndarray:
    """How often each row is drawn in 2,000 batches."""
    section = CorrectionSection(acceptance=acceptance, **settings)
    sampler = rule(acceptance)(Given(scores), section, BATCH)
    rows = torch.zeros(1200, 3)
    random = np.random.default_rng(0)
    begun = sampler.begin(held_by({}, Data(rows, rows[:, :0]), EXTENT, random))
    indices = sampler.sample_indices(random, 2000, EXTENT)
    counts = np.zeros(EXTENT.size, np.int64)
    for update in range(2000):
        sampled = {name: torch.from_numpy(array[update]) for name, array in indices.items()}
        chosen = sampler.select({}, sampler.gather({}, begun.data, sampled), sampled)
        assert chosen.rows.shape == (BATCH,) and torch.equal(chosen.rows, chosen.imitated)
        counts += np.bincount(chosen.rows.numpy(), minlength=EXTENT.size)
    return counts


def test_the_best_share_and_the_newest_data_are_drawn_alike_and_nothing_else() -> None:
    scores = np.random.default_rng(1).permutation(1000).astype(np.float64)
    counts = drawn("share", scores, share=0.2)
    accepted = (scores < 200) | (np.arange(1000) >= EXTENT.newest)
    assert not counts[~accepted].any()
    assert stats.chisquare(counts[accepted]).pvalue > 1e-3


@pytest.mark.parametrize("acceptance", [share, conformal])
def test_a_quantile_is_the_row_up_to_whose_weight_it_reaches(acceptance: ModuleType) -> None:
    """To the row, also at the ends; whether it is looked up or searched for."""
    random = np.random.default_rng(5)
    scores = np.concatenate([random.random(950) * 2, random.random(50) - 10])  # held out: 0 to 1
    given, section = Given(scores), CorrectionSection(share=0.3, level=0.2)
    rows = torch.zeros(1000, 3)
    held = held_by({}, Data(rows, rows[:, :0]), EXTENT, random)
    sampler = acceptance.create(given, section, BATCH)
    data = sampler.begin(held).data
    assert ("accepted" in data.prepared) == (acceptance is share)
    judged = given.scores(held, exclude_self=acceptance is conformal).values
    weights = acceptance.weights(section, judged, EXTENT).double()
    weights[EXTENT.newest :] = 1.0
    sums = np.cumsum(weights.numpy())
    quantiles = np.append(random.random(5000), [0.0, 1 - 2.0**-53])
    found = sampler.gather({}, data, {"quantile": torch.from_numpy(quantiles)})["rows"]
    assert np.array_equal(found, np.searchsorted(sums, quantiles * sums[-1], side="right"))


def test_of_equal_scores_exactly_the_share_is_accepted() -> None:
    weights = share.weights(CorrectionSection(share=0.25), torch.zeros(1000), EXTENT)
    assert weights.sum() == 250


def test_conformal_accepts_by_the_p_value_among_the_newest_data() -> None:
    random = np.random.default_rng(2)
    scores = np.concatenate([random.random(950) * 2, random.random(50) - 10])  # held out: 0 to 1
    counts = drawn("conformal", scores, level=0.2)
    held_out = np.sort(scores[950:] + 10)
    p = (1 + (held_out[None] >= scores[:950, None]).sum(1)) / 51
    expected = np.concatenate([np.minimum(1, p / 0.2), np.ones(50)])
    assert stats.chisquare(counts, expected / expected.sum() * counts.sum()).pvalue > 1e-3
    assert (p < 0.2).sum() > 300  # the test says something


@pytest.mark.parametrize("level", [0.01, 0.1])
def test_conformal_accepts_nearly_everything_where_nothing_differs(level: float) -> None:
    scores = torch.from_numpy(np.random.default_rng(3).exponential(size=10_000))
    extent = Extent(offline=9000, newest=9000, size=10_000)
    weights = conformal.weights(CorrectionSection(level=level), scores, extent)
    assert weights[:9000].mean() > 1 - level


def test_a_batch_holds_as_much_online_data_as_described() -> None:
    from .test_samplers import one_update, setting

    section = UniformSection(online_share=0.5)
    from otc_dist.otc import create_sampler

    sampler = create_sampler(setting(section), 450)
    for seed in range(20):
        sampled = one_update(sampler, seed)
        chosen = sampler.select({}, {}, sampled)
        assert chosen.rows.shape == (16,)
        assert (chosen.rows[8:] >= 300).all()  # D_1 .. D_k
        assert (chosen.rows[:8] < 300).any()
