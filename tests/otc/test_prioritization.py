"""Eq. 3: the chances of a transition by the rank of its distance."""

from itertools import permutations

import numpy as np
import pytest
import torch
from scipy import stats
from torch import Tensor

from otc_dist.otc.prioritization import prioritize

from . import plain

DISTANCES = torch.tensor([0.3, 0.1, 0.9, 0.2, 0.5, 0.7])
TRIALS = 6000


def sample(
    alpha: float,
    *,
    replace: bool,
    count: int = 1,
    distances: Tensor = DISTANCES,
    trials: int = TRIALS,
) -> np.ndarray:
    """Positions (trials, count) from independent noise."""
    noise = np.random.default_rng(0).standard_exponential((trials, len(distances)))
    draw = torch.vmap(
        lambda n: prioritize(
            distances.double(), torch.tensor(alpha).double(), n, count, with_replacement=replace
        )
    )
    return draw(torch.from_numpy(noise)).numpy()


@pytest.mark.parametrize("replace", [True, False])
@pytest.mark.parametrize("alpha", [0.0, 0.7, 1.0, 3.0])
def test_selection_equals_the_plain_version(alpha: float, replace: bool) -> None:
    random = np.random.default_rng(1)
    for count in (1, 7, 40):
        distances = random.integers(0, 20, 60) / 4  # with ties
        noise = random.standard_exponential(60)
        chosen = prioritize(
            torch.from_numpy(distances),
            torch.tensor(alpha, dtype=torch.float64),
            torch.from_numpy(noise),
            count,
            with_replacement=replace,
        )
        expected = plain.prioritized(distances, alpha, noise, count, replace)
        assert chosen.tolist() == expected


@pytest.mark.parametrize("replace", [True, False])
@pytest.mark.parametrize("alpha", [0.0, 1.0, 2.0])
def test_first_choice_has_the_chances_of_eq_3(alpha: float, replace: bool) -> None:
    counts = np.bincount(sample(alpha, replace=replace)[:, 0], minlength=len(DISTANCES))
    expected = plain.priorities(DISTANCES.numpy(), alpha)
    assert stats.chisquare(counts, TRIALS * expected).pvalue > 1e-3


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_pairs_without_replacement_have_the_chances_of_successive_draws(alpha: float) -> None:
    """P(i, then j) = p_i p_j / (1 - p_i)."""
    p = plain.priorities(DISTANCES.numpy(), alpha)
    pairs = sample(alpha, replace=False, count=2)
    orders = list(permutations(range(len(p)), 2))
    counts = [int(((pairs[:, 0] == i) & (pairs[:, 1] == j)).sum()) for i, j in orders]
    expected = [TRIALS * p[i] * p[j] / (1 - p[i]) for i, j in orders]
    assert stats.chisquare(counts, expected).pvalue > 1e-3


def test_alpha_zero_without_replacement_includes_each_equally_often() -> None:
    chosen = sample(0.0, replace=False, count=3)
    assert all(len(set(row)) == 3 for row in chosen)
    included = np.bincount(chosen.ravel(), minlength=len(DISTANCES)) / TRIALS
    assert (np.abs(included - 0.5) < 0.03).all()  # 4.6 standard deviations


@pytest.mark.parametrize("replace", [True, False])
def test_chances_fall_with_distance(replace: bool) -> None:
    chosen = sample(1.0, replace=replace, count=2)
    included = np.bincount(chosen.ravel(), minlength=len(DISTANCES))
    assert (np.diff(included[DISTANCES.argsort()]) < 0).all()


@pytest.mark.parametrize("replace", [True, False])
def test_only_ranks_matter(replace: bool) -> None:
    """A monotone map of the distances changes no choice."""
    distances = DISTANCES.double()
    for mapped in (distances**3, distances.log(), 100 * distances - 7, distances.exp()):
        chosen = sample(1.3, replace=replace, count=3, distances=mapped, trials=50)
        same = sample(1.3, replace=replace, count=3, distances=distances, trials=50)
        assert np.array_equal(chosen, same)


@pytest.mark.parametrize("replace", [True, False])
def test_permuting_the_minibatch_permutes_the_choice(replace: bool) -> None:
    order = np.array([4, 0, 3, 5, 1, 2])
    chosen = sample(1.0, replace=replace, count=3, trials=200)
    permuted = sample(1.0, replace=replace, count=3, distances=DISTANCES[order], trials=200)
    assert np.array_equal(order[permuted], chosen)


def test_ties_in_the_rank_fall_at_random_in_minibatches_of_random_order() -> None:
    """Equal distances get equal shares although Eq. 3 gives their ranks unequal chances."""
    random = np.random.default_rng(2)
    values = np.array([0.0, 0.5, 0.5, 0.5, 2.0])
    counts = np.zeros(len(values))
    for noise in random.standard_exponential((4000, len(values))):
        order = random.permutation(len(values))
        chosen = prioritize(
            torch.from_numpy(values[order]),
            torch.tensor(2.0).double(),
            torch.from_numpy(noise),
            1,
            with_replacement=False,
        )
        counts[order[chosen]] += 1
    assert stats.chisquare(counts[1:4]).pvalue > 1e-3
    assert counts[0] > counts[1:4].max() and counts[4] < counts[1:4].min()
