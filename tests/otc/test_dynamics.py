"""d_f and `typical`: what a forward model expects, and how far each transition is from it."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import torch

from otc_dist.description import DynamicsSection
from otc_dist.otc.data import Data
from otc_dist.otc.distances.dynamics import DynamicsDistance
from otc_dist.otc.distances.typical import Misses, TypicalDistance
from otc_dist.otc.forward import Forward, apart
from otc_dist.otc.samplers.interface import Extent, MergedData
from otc_dist.randomness import stream
from otc_dist.steps.engine import Engine
from otc_dist.transitions import RowLayout

LAYOUT = RowLayout(2, 1)
SECTION = DynamicsSection(hidden=(32,), updates=300, batch_size=64, correction_hidden=(32,))
OFFLINE, NEWEST = 4000, 1200


def random(*key: int | str) -> np.random.Generator:
    return stream(0, *key)


def ignore(done: int, metrics: dict[str, float]) -> None:
    pass


def transitions(count: int, others: Callable[[int], np.ndarray], seed: int) -> torch.Tensor:
    """Rows in which s' - s = 0.2 a + 0.3 b (1, -1), b what the others did."""
    source = np.random.default_rng(seed)
    s, a = source.uniform(-1, 1, (count, 2)), source.uniform(-1, 1, (count, 1))
    then = s + 0.2 * a + 0.3 * others(count)[:, None] * np.array([1, -1])
    zero = np.zeros((count, 1))
    return torch.from_numpy(np.hstack([s, a, zero, then, zero]).astype(np.float32))


def mostly_left(count: int) -> np.ndarray:
    """In the data the others go left four times in five."""
    return np.where(np.random.default_rng(5).random(count) < 0.8, -1.0, 1.0)


@cache
def fitted() -> tuple[torch.Tensor, torch.Tensor, Forward]:
    """One agent's rows with D_1, in which the others go right, their folds, and f_B."""
    rows = torch.cat([transitions(OFFLINE, mostly_left, 1), transitions(NEWEST, np.ones, 2)])
    folds = torch.arange(len(rows)) // 10 % 2  # episodes of ten steps
    engine = Engine("eager")
    forward = Forward(SECTION, LAYOUT, engine)
    untouched = torch.full((len(rows), forward.size), torch.nan)
    forward.embed(rows, folds, untouched)
    assert untouched.isnan().all()  # not before it is fitted
    forward.fit(rows[:OFFLINE], folds[:OFFLINE], random, ignore)
    return rows, folds, forward


@cache
def held(kind: type[Forward]) -> tuple[MergedData, np.ndarray]:
    """The same with what a distance keeps of each row, and what the others did in it."""
    rows, folds, forward = fitted()
    own = kind(SECTION, LAYOUT, Engine("eager"))
    own.state = forward.state
    features = torch.zeros(len(rows), own.size)
    own.embed(rows, folds, features)
    extent = Extent(OFFLINE, OFFLINE, len(rows))
    others = np.concatenate([mostly_left(OFFLINE), np.ones(NEWEST)])
    return MergedData({}, Data(rows, features, folds), extent, Engine("eager"), random), others


def test_typical_prefers_what_the_others_usually_did() -> None:
    ready, others = held(Misses)
    scores = TypicalDistance().scores(ready, exclude_self=False).values.numpy()[:OFFLINE]
    assert (others[:OFFLINE][np.argsort(scores)[:400]] == -1).all()


def test_dynamics_prefers_what_the_others_do_now() -> None:
    ready, others = held(Forward)
    scores = DynamicsDistance(LAYOUT, SECTION).scores(ready, exclude_self=False).values.numpy()
    best = np.argsort(scores[:OFFLINE])[:400]
    assert (others[:OFFLINE][best] == 1).all()
    again = DynamicsDistance(LAYOUT, SECTION).scores(ready, exclude_self=False).values.numpy()
    assert (scores == again).all()  # to the bit


def test_no_transition_judges_itself() -> None:
    """A transition that is changed changes its own score, but not by what is fitted to it: the
    network that judges it is the same to the bit."""
    rows = transitions(200, mostly_left, 3)
    folds = torch.arange(200) % 2
    states = []
    for change in (0.0, 50.0):
        changed = rows.clone()
        changed[0, LAYOUT.next_observation] += change
        forward = Forward(SECTION.model_copy(update={"updates": 20}), LAYOUT, Engine("eager"))
        # The moments by which transitions are standardised come from all of B_0.
        forward._changes.fit(rows, folds, random, ignore)
        moments = forward._changes.state
        forward._changes.fit = lambda *ignored: None  # type: ignore[method-assign]
        forward._changes.state = moments
        forward.fit(changed, folds, random, ignore)
        states.append(forward.state or {})
    assert torch.equal(states[0]["network_0"], states[1]["network_0"])  # judges fold 0
    assert not torch.equal(states[0]["network_1"], states[1]["network_1"])


def test_the_newest_data_are_judged_by_the_half_that_they_are_not_in() -> None:
    """So their scores are held out: memorised noise would make them smaller than the others'."""
    source = np.random.default_rng(7)

    def noisy(count: int) -> np.ndarray:
        return source.normal(size=count)

    rows = torch.cat([transitions(2000, noisy, 1), transitions(60, noisy, 2)])
    folds = torch.arange(len(rows)) % 2
    section = SECTION.model_copy(update={"correction_updates": 200})
    forward = Forward(section, LAYOUT, Engine("eager"))
    forward.fit(rows[:2000], folds[:2000], random, ignore)
    features = torch.zeros(len(rows), forward.size)
    forward.embed(rows, folds, features)
    ready = MergedData(
        {}, Data(rows, features, folds), Extent(2000, 2000, 2060), Engine("eager"), random
    )
    scores = DynamicsDistance(LAYOUT, section).scores(ready, exclude_self=False).values
    assert scores[2000:].mean() == pytest.approx(scores[:2000].mean(), rel=0.5)


def test_a_correction_that_does_not_help_is_left_out() -> None:
    """Where D_k follows B_0, c_k has nothing to learn, and d_f stays near `typical`."""
    scores = []
    for kind, distance in (
        (Forward, DynamicsDistance(LAYOUT, SECTION)),
        (Misses, TypicalDistance()),
    ):
        ready, _ = held(kind)
        ready = ready._replace(extent=Extent(OFFLINE - 60, OFFLINE - 60, OFFLINE))  # D_1 of B_0
        scores.append(distance.scores(ready, exclude_self=False).values)
    corrected, plain = scores
    assert np.corrcoef(corrected, plain)[0, 1] > 0.7


def test_features_are_the_pair_and_the_residual() -> None:
    ready, _ = held(Forward)
    pairs, residual = apart(ready.data.features, 3)
    assert pairs.shape == (OFFLINE + NEWEST, 3) and residual.shape == (OFFLINE + NEWEST, 2)
    assert pairs[:OFFLINE].mean(0).abs().max() < 0.05
    alone = held(Misses)[0].data.features
    assert torch.equal(alone[:, 0], residual.square().sum(1))
