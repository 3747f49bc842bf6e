"""The sampling strategies: which rows they look at, and OTC's choice against plain loops."""

from itertools import product
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats

from benchmarks.plain.bcq import PlainBcq
from otc_dist.algorithms.bcq import Bcq, BcqSection
from otc_dist.algorithms.interface import unpack
from otc_dist.description import SamplingSection
from otc_dist.description.kinds import STRATEGIES
from otc_dist.otc import create_sampler
from otc_dist.otc.acceptance.rank import RankMatched
from otc_dist.otc.data import Data
from otc_dist.otc.distances import create_distance
from otc_dist.otc.distances.interface import Matching, Setting
from otc_dist.otc.samplers.correction import CorrectionSection
from otc_dist.otc.samplers.interface import Extent, MergedData
from otc_dist.steps.noise import Noise, sample_noise
from otc_dist.steps.state import State
from otc_dist.transitions import RowLayout

from ..brains import describe
from ..flat_weights import load
from . import plain
from .held import held_by

S, A, BATCH = 5, 2, 16
LAYOUT = RowLayout(S, A)
EXTENT = Extent(offline=300, newest=360, size=400)  # D_1 is [300, 360), D_2 is [360, 400)
ALGORITHM = Bcq(S, A, BcqSection(hidden=(16, 16)))
CHOICES = [
    *product(["embedding"], ["relative"], [False, True], [False, True]),
    *product(["change"], ["relative"], [False, True], [False, True]),
    *product(["value"], ["relative", "shared", "paper"], [False, True], [False, True]),
]


def settings(**changes: Any) -> Any:
    values: dict[str, Any] = {
        **{"distance": "embedding", "acceptance": "rank"},
        **{"candidates": 64, "references": 30, "value_samples": 3},
    }
    return STRATEGIES.chosen(values | changes)


def held(seed: int = 0) -> Data:
    """Rows and embeddings; after `EXTENT.size` NaN, which nobody may look at."""
    random = np.random.default_rng(seed)
    rows = random.standard_normal((450, LAYOUT.width))
    rows[:, LAYOUT.terminated] = random.random(450) < 0.2
    embeddings = random.standard_normal((450, S + A + S))  # as d_c's; any size is right for d_e
    for array in (rows, embeddings):
        array[EXTENT.size :] = np.nan
    folds = torch.arange(450) % 2
    return Data(torch.from_numpy(rows), torch.from_numpy(embeddings), folds)


def setting(section: SamplingSection) -> Setting:
    algorithm = {"hidden": [16, 16], "batch_size": BATCH}
    changes = {"sampling": section, "algorithm": BcqSection(**algorithm)}
    return Setting(describe().model_copy(update=changes), LAYOUT, ALGORITHM)


def matched(section: CorrectionSection) -> RankMatched:
    distance = create_distance(section.distance, setting(section))
    assert isinstance(distance, Matching)
    return RankMatched(section, BATCH, distance)


def prepared(data: Data, extent: Extent = EXTENT, weights: State | None = None) -> MergedData:
    return held_by(weights or state(), data, extent, np.random.default_rng(0))


def state(seed: int = 0) -> State:
    initial = ALGORITHM.initial_state(np.random.default_rng(seed), unpack(held().rows, LAYOUT))
    return {name: torch.from_numpy(np.array(x, np.float64)) for name, x in initial.items()}


def at(alpha: float, data: Data) -> Data:
    """As `begin` prepares data for alpha."""
    return data._replace(prepared={"alpha": torch.tensor(alpha).double()})


def one_update(sampler: Any, seed: int) -> Noise:
    random = np.random.default_rng(seed)
    arrays = {
        **sampler.sample_indices(random, 1, EXTENT),
        **sample_noise(random, sampler.noise_spec(), 1),
    }
    return {
        name: torch.from_numpy(array if array.dtype == np.int64 else array.astype(np.float64))[0]
        for name, array in arrays.items()
    }


def plain_distances(
    section: CorrectionSection, state: State, data: Data, candidates: Any, online: Any, noise: Noise
) -> np.ndarray:
    """d(s', s'*) one candidate at a time."""
    bcq = PlainBcq(ALGORITHM.settings, S, A, torch.float64)
    twins = [bcq.critics.first, bcq.critics.second]
    load(
        {"vae": [bcq.encoder, bcq.decoder], "actor": [bcq.actor], "critic": [twins]},
        state,
    )
    forbidden = candidates[:, None] == online[None, :] if section.exclude_self else None
    if section.distance == "embedding":
        mu = data.features.numpy()
        gap = np.abs(mu[candidates][:, None] - mu[online][None]).sum(-1)
        return np.where(forbidden, np.inf, gap).min(1) if forbidden is not None else gap.min(1)
    if section.distance == "change":
        features, distances = data.features.numpy(), []
        for row in candidates:
            allowed = [i for i in online if not (section.exclude_self and i == row)]
            gaps = [np.abs(features[row] - features[i])[: S + A].sum() for i in allowed]
            match = allowed[int(np.argmin(gaps))]
            distances.append(np.abs(features[row] - features[match])[S + A :].sum())
        return np.array(distances)
    rows = data.rows

    def q(numbers: Any) -> np.ndarray:
        batch = unpack(rows[numbers], LAYOUT)
        return bcq.critics.one(batch.observation, batch.action).numpy()

    def v(numbers: Any) -> np.ndarray:
        batch = unpack(rows[numbers], LAYOUT)
        values = bcq.value(batch.next_observation, noise["value"]).numpy()
        return np.where(batch.terminated == 1, 0.0, values)

    with torch.no_grad():
        gap = np.abs(q(candidates)[:, None] - q(online)[None, :])
        if forbidden is not None:
            gap = np.where(forbidden, np.inf, gap)
        matched = online[gap.argmin(1)]
        values, matched_values = v(candidates), v(matched)
    if section.normaliser == "relative":  # terminal matches: V* = 0 is guarded
        spread = np.concatenate([values, matched_values]).std(ddof=1)
        small = np.abs(matched_values) < 0.01 * spread
        sign = np.where(matched_values < 0, -1, 1)
        scale = np.where(small, 0.01 * spread * sign, matched_values)
        return np.abs((values - matched_values) / scale)
    return plain.value_distance(values, matched_values, section.normaliser)


@pytest.mark.parametrize(("distance", "normaliser", "replace", "exclude"), CHOICES)
@pytest.mark.parametrize("matching", ["minibatch", "exact"])
def test_otc_chooses_what_plain_loops_choose(
    matching: str, distance: str, normaliser: str, replace: bool, exclude: bool
) -> None:
    section = settings(
        matching=matching,
        distance=distance,
        normaliser=normaliser,
        with_replacement=replace,
        exclude_self=exclude,
    )
    sampler, data, weights = matched(section), held(), state()
    for seed, alpha in enumerate([0.0, 1.0, 2.5]):
        sampled = one_update(sampler, seed)
        with torch.no_grad():
            gathered = sampler.gather(weights, at(alpha, data), sampled)
            distances, _ = sampler.distances(weights, gathered, sampled)
            chosen = sampler.select(weights, gathered, sampled).rows
        candidates, online = sampled["candidates"].numpy(), sampled["references"].numpy()
        expected = plain_distances(section, weights, data, candidates, online, sampled)
        np.testing.assert_allclose(distances, expected, rtol=1e-9, atol=1e-12)
        positions = plain.prioritized(
            expected, alpha, sampled["priority"].numpy(), BATCH, section.with_replacement
        )
        assert chosen.tolist() == candidates[positions].tolist()


@pytest.mark.parametrize("distance", ["embedding", "value", "change"])
def test_minibatches_come_from_where_they_should(distance: str) -> None:
    sampler = matched(settings(distance=distance))
    drawn = sampler.sample_indices(np.random.default_rng(0), 500, EXTENT)
    assert drawn["candidates"].shape == (500, 64) and drawn["references"].shape == (500, 30)
    counts = np.bincount(drawn["candidates"].ravel(), minlength=400)  # B_k: all of it, uniformly
    assert len(counts) == 400 and stats.chisquare(counts).pvalue > 1e-3
    online = drawn["references"]  # D_k: the newest only, none twice in a minibatch
    assert online.min() == 360 and online.max() == 399
    assert all(len(set(row)) == 30 for row in online)
    places = np.bincount(online[:, 0] - 360, minlength=40)  # in random order
    assert stats.chisquare(places).pvalue > 1e-3


def test_a_small_online_set_is_taken_whole() -> None:
    sampler = matched(settings(references=2000))
    drawn = sampler.sample_indices(np.random.default_rng(0), 3, EXTENT)["references"]
    assert [sorted(row) for row in drawn.tolist()] == [list(range(360, 400))] * 3


def test_exact_matching_looks_at_all_of_the_newest_data() -> None:
    sampler = matched(settings(distance="value", matching="exact", references=3))
    drawn = sampler.sample_indices(np.random.default_rng(0), 3, EXTENT)["references"]
    assert [sorted(row) for row in drawn.tolist()] == [list(range(360, 400))] * 3
    assert drawn[0].tolist() != drawn[1].tolist()  # in random order, for ties


def test_terminal_next_states_have_value_zero() -> None:
    data = held()
    data.rows[:, LAYOUT.terminated] = 1
    sampler = matched(settings(distance="value"))
    sampled = one_update(sampler, 0)
    with torch.no_grad():
        distances, guarded = sampler.distances(state(), sampler.pairs(data, sampled), sampled)
    assert torch.equal(distances, torch.zeros(64).double())
    assert guarded == 64


@pytest.mark.parametrize("distance", ["embedding", "value", "change"])
def test_online_transitions_match_themselves_unless_excluded(distance: str) -> None:
    for exclude, expected in ((False, True), (True, False)):
        section = settings(distance=distance, matching="exact", exclude_self=exclude)
        sampler, data = matched(section), held()
        sampled = one_update(sampler, 0)
        own = sampled["candidates"] >= EXTENT.newest
        with torch.no_grad():
            distances, _ = sampler.distances(state(), sampler.pairs(data, sampled), sampled)
        assert own.any()
        assert bool((distances[own] == 0).all()) is expected


def test_uniform_covers_all_and_online_only_covers_the_online_data() -> None:
    for name, first in (("uniform", 0), ("online-only", 300)):
        sampler = create_sampler(setting(settings(name=name)), 450)
        sampled = sampler.sample_indices(np.random.default_rng(0), 2000, EXTENT)
        assert sampled["batch"].shape == (2000, BATCH)
        counts = np.bincount(sampled["batch"].ravel(), minlength=400)
        assert counts[:first].sum() == 0 and len(counts) == 400
        assert stats.chisquare(counts[first:]).pvalue > 1e-3
        one = {"batch": torch.from_numpy(sampled["batch"][0])}
        selection = sampler.select(state(), sampler.gather({}, held(), one), one)
        assert torch.equal(selection.rows, one["batch"]) and selection.metrics is None


@pytest.mark.parametrize("distance", ["embedding", "change"])
@pytest.mark.parametrize("exclude", [False, True])
def test_expected_similarity_is_the_mean_distance(exclude: bool, distance: str) -> None:
    data = held()
    everything = EXTENT._replace(offline=400)  # so that the sample is all of B_k
    section = settings(similarity_sample=400, exclude_self=exclude, distance=distance)
    numbers, online = np.arange(400), np.arange(360, 400)
    expected = plain_distances(section, state(), data, numbers, online, {}).mean()
    found = matched(section).begin(prepared(data, everything)).measured["similarity"]
    assert found == pytest.approx(expected, rel=1e-12)


def test_sample_of_the_similarity_keeps_its_size_as_data_grow() -> None:
    sizes = []

    class Counting(np.random.Generator):
        def choice(self, a: Any, size: Any = None, **other: Any) -> Any:
            sizes.append(size)
            return super().choice(a, size, **other)

    for size in (360, 400):
        extent = EXTENT._replace(size=size, newest=size - 40)
        random = Counting(np.random.PCG64(0))
        ready = prepared(held(), extent)._replace(random=lambda *key, random=random: random)
        matched(settings(similarity_sample=350)).begin(ready)
    assert sizes == [300, 300]


@pytest.mark.parametrize("normaliser", ["relative", "shared", "paper"])
def test_expected_similarity_by_value_is_exact(
    normaliser: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over all of B_k and D_k, in chunks; the perturbed mean action makes V free of noise here."""
    monkeypatch.setattr("otc_dist.otc.distances.value.CHUNK", 64)
    data, weights = held(), state()
    data = data._replace(rows=data.rows.float())
    weights["vae"] = weights["vae"] * 0  # every decoded action is 0
    single = {name: tensor.float() for name, tensor in weights.items()}
    section = settings(distance="value", normaliser=normaliser, matching="exact")
    numbers, online = np.arange(400), np.arange(360, 400)
    noise = {"value": torch.zeros(400, 1, 2 * A).double()}
    exact = data._replace(rows=data.rows.double())
    expected = plain_distances(section, weights, exact, numbers, online, noise).mean()
    with torch.no_grad():
        found = matched(section).begin(prepared(data, weights=single)).measured["similarity"]
    assert found == pytest.approx(expected, rel=1e-3)
