"""What d_c looks at, and that it sees a change of dynamics where the action alone tells nothing."""

import numpy as np
import pytest
import torch

from otc_dist.otc.distances.change import Changes, matched_l1
from otc_dist.transitions import RowLayout, Transitions

NO_FOLDS = torch.zeros(0)


def packed(layout: RowLayout, s: np.ndarray, a: np.ndarray, then: np.ndarray) -> torch.Tensor:
    no = np.zeros(len(s), np.bool_)
    arrays = (x.astype(np.float32) for x in (s, a, no, then))
    return torch.from_numpy(layout.pack(Transitions(*arrays, no, no)))


def features(changes: Changes, rows: torch.Tensor) -> np.ndarray:
    out = torch.full((len(rows), changes.size), torch.nan)
    changes.embed(rows, NO_FOLDS, out)
    return out.numpy()


def test_features_are_the_standardised_pair_and_change() -> None:
    random = np.random.default_rng(0)
    s, a = random.normal(3, 2, (500, 3)), random.uniform(-1, 1, (500, 2))
    change = random.normal(-1, 0.01, (500, 3))
    changes, rows = Changes(RowLayout(3, 2)), packed(RowLayout(3, 2), s, a, s + change)
    assert np.isnan(features(changes, rows)).all()  # not before it knows B_0
    changes.fit(rows, NO_FOLDS, np.random.default_rng, print)
    found = features(changes, rows)
    raw = np.concatenate([s, a, change], axis=1)
    expected = (raw - raw.mean(0)) / (raw.std(0, ddof=0) + 1e-3)
    np.testing.assert_allclose(found, expected, atol=2e-3)
    assert (changes.matched, changes.size) == (5, 8)


def test_an_index_of_a_discrete_action_is_told_as_a_one_hot_vector() -> None:
    layout = RowLayout(5, 1, 3)  # the last three are the mask
    s, a = np.ones((3, 5)), np.arange(3)[:, None]
    changes = Changes(layout)
    rows = packed(layout, s, a, s)
    changes.fit(rows, NO_FOLDS, np.random.default_rng, print)
    assert (changes.matched, changes.size) == (8, 13)
    assert (features(changes, rows)[:, 5:8].argmax(1) == np.arange(3)).all()


@pytest.mark.parametrize("beta", [0.1, -0.1])
def test_of_two_kinds_of_dynamics_it_prefers_the_online_one(beta: float) -> None:
    random = np.random.default_rng(1)
    s, a = random.uniform(-1, 1, (4000, 2)), random.uniform(-1, 1, (4000, 2))
    kind = np.where(np.arange(4000) < 1000, beta, random.choice([-0.1, 0.1], 4000))
    changes, rows = Changes(RowLayout(2, 2)), packed(RowLayout(2, 2), s, a, s + kind[:, None] * a)
    changes.fit(rows, NO_FOLDS, np.random.default_rng, print)
    known = torch.from_numpy(features(changes, rows))
    distances = matched_l1(known[1000:], known[:1000], changes.matched).numpy()
    nearest = np.argsort(distances)[:500]
    assert (kind[1000:][nearest] == beta).mean() > 0.75
