"""Matching and the two distances: against brute force, and their invariances."""

import numpy as np
import pytest
import torch
from torch import Tensor

from otc_dist.otc.distances.embedding import nearest_l1
from otc_dist.otc.distances.value import GUARD, match_values, next_state_distance
from otc_dist.otc.samplers.correction import NormaliserName

from . import plain

NORMALISERS: tuple[NormaliserName, ...] = ("paper", "shared", "relative")


def normal(seed: int, *shape: int) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal(shape))


def test_nearest_l1_equals_brute_force() -> None:
    queries, online = normal(0, 60, 10), normal(1, 90, 10)
    expected = plain.nearest_l1(queries.numpy(), online.numpy())
    np.testing.assert_allclose(nearest_l1(queries, online), expected, rtol=1e-12)


@pytest.mark.parametrize("size", [1, 2, 3, 500])
def test_match_by_searchsorted_equals_dense(size: int) -> None:
    q, online = 3 * normal(2, 400), normal(3, size)  # some queries lie outside of D's range
    matches = match_values(q, online)
    assert matches.tolist() == plain.match_by_value(q.numpy(), online.numpy()).tolist()


def test_match_where_many_values_are_equal_is_as_near_as_dense() -> None:
    random = np.random.default_rng(4)
    q, online = (torch.from_numpy(random.integers(0, 50, n) / 2) for n in (300, 40))
    gap = (q - online[match_values(q, online)]).abs()
    dense = (q[:, None] - online[None]).abs().amin(1)
    assert torch.equal(gap, dense)


@pytest.mark.parametrize("values", [(1.0, 1.0), (0.0, 2.0), (1.0, 1.0, 0.0, 2.0)])
def test_ties_in_the_match_fall_at_random(values: tuple[float, ...]) -> None:
    """Equal references, and references equally far on either side, in a random order."""
    random = np.random.default_rng(5)
    counts = np.zeros(len(values))
    nearest = np.abs(np.array(values) - 1.0)
    for _ in range(2000):
        order = random.permutation(len(values))
        match = match_values(torch.tensor([1.0]), torch.tensor(values)[order])
        counts[order[match]] += 1
    tied = nearest == nearest.min()
    assert counts[~tied].sum() == 0
    share = counts[tied] / 2000
    assert (np.abs(share - 1 / tied.sum()) < 0.05).all()  # about 4.5 standard deviations


def test_match_is_invariant_to_affine_maps_of_q() -> None:
    q, online = normal(6, 400), normal(7, 300)
    expected = match_values(q, online)
    assert torch.equal(match_values(4 * q + 8, 4 * online + 8), expected)  # exact in binary
    # A falling map turns the order about and keeps distances.
    assert torch.equal(match_values(-q, -online), expected)


def test_permuting_the_queries_permutes_the_distances() -> None:
    queries, online = normal(8, 50, 4), normal(9, 70, 4)
    order = torch.randperm(50, generator=torch.Generator().manual_seed(0))
    assert torch.equal(nearest_l1(queries[order], online), nearest_l1(queries, online)[order])
    q, online_q = normal(8, 50), normal(9, 70)
    assert torch.equal(match_values(q[order], online_q), match_values(q, online_q)[order])


def test_permuting_the_references_changes_no_distance() -> None:
    queries, online = normal(8, 50, 4), normal(9, 70, 4)
    order = torch.randperm(70, generator=torch.Generator().manual_seed(0))
    assert torch.equal(nearest_l1(queries, online[order]), nearest_l1(queries, online))
    q, online_q = normal(8, 50), normal(9, 70)
    assert torch.equal(order[match_values(q, online_q[order])], match_values(q, online_q))


def test_exclude_self_matches_the_nearest_other() -> None:
    """Queries that are references themselves must match another one, as dense matching finds."""
    online, online_e = normal(10, 30), normal(11, 30, 3)
    numbers = torch.arange(100, 130)
    ids = (numbers, numbers)
    assert torch.equal(match_values(online, online), torch.arange(30))
    assert nearest_l1(online_e, online_e).max() == 0
    dense = (online[:, None] - online[None]).abs().fill_diagonal_(torch.inf)
    assert torch.equal(match_values(online, online, ids), dense.argmin(1))
    expected = torch.cdist(online_e, online_e, p=1).fill_diagonal_(torch.inf).amin(1)
    torch.testing.assert_close(nearest_l1(online_e, online_e, ids), expected)


def test_exclude_self_keeps_twins_of_the_query() -> None:
    """Another transition of the same value is a match; only the query itself is none."""
    q = torch.tensor([1.0, 1.0, 5.0])
    ids = (torch.tensor([0, 1, 2]), torch.tensor([0, 1, 2]))
    assert match_values(q, q, ids).tolist()[:2] == [1, 0]


@pytest.mark.parametrize("normaliser", NORMALISERS)
def test_value_distance_equals_the_formula(normaliser: NormaliserName) -> None:
    v, matched = 5 + normal(12, 200), 4 + normal(13, 200)
    distances, guarded = next_state_distance(v, matched, normaliser)
    expected = plain.value_distance(v.numpy(), matched.numpy(), normaliser)
    np.testing.assert_allclose(distances, expected, rtol=1e-12)
    assert guarded == 0


@pytest.mark.parametrize("normaliser", NORMALISERS)
@pytest.mark.parametrize("factor", [4.0, -0.5])
def test_value_distance_is_invariant_to_scale_and_not_to_shift(
    normaliser: NormaliserName, factor: float
) -> None:
    v, matched = 5 + normal(14, 200), 4 + normal(15, 200)
    expected, _ = next_state_distance(v, matched, normaliser)
    scaled, _ = next_state_distance(factor * v, factor * matched, normaliser)
    torch.testing.assert_close(scaled, expected, rtol=1e-12, atol=0)
    shifted, _ = next_state_distance(v + 3, matched + 3, normaliser)
    assert not torch.allclose(shifted, expected, rtol=0.05)


def test_paper_normaliser_ranks_by_value_where_means_differ() -> None:
    """Perfect matches up to a common factor: the known defect of separate means."""
    v = torch.linspace(1, 10, 50).double()
    distances, _ = next_state_distance(v, v.flip(0), "paper")
    assert distances.max() > 0
    same, _ = next_state_distance(v, v, "paper")
    assert same.max() == 0
    # A match whose V is V(s') itself but among worse ones elsewhere is at a distance growing in V.
    mixed = torch.cat((v[:25], v[25:] / 2))
    paper, _ = next_state_distance(v, mixed, "paper")
    perfect = paper[:25]  # V = V* here
    assert (perfect.diff() > 0).all() and perfect[0] > 0
    relative, _ = next_state_distance(v, mixed, "relative")
    assert relative[:25].max() == 0


@pytest.mark.parametrize("normaliser", NORMALISERS)
def test_a_normaliser_near_zero_is_replaced_and_counted(normaliser: NormaliserName) -> None:
    v = 1 + normal(16, 50).abs()
    v = torch.cat((v, -v))  # of mean zero, none near zero
    matched = v.flip(0).clone()
    if normaliser == "relative":
        matched[:3] = torch.tensor([0.0, 1e-9, -1e-9])
    distances, guarded = next_state_distance(v, matched, normaliser)
    assert guarded == {"paper": 2, "shared": 1, "relative": 3}[normaliser]
    assert torch.isfinite(distances).all()
    spread = torch.cat((v, matched)).std()
    if normaliser == "relative":
        torch.testing.assert_close(distances[0], v[0].abs() / (GUARD * spread))
        torch.testing.assert_close(distances[2], (v[2] + 1e-9).abs() / (GUARD * spread))


@pytest.mark.parametrize("normaliser", NORMALISERS)
def test_all_values_zero_gives_no_nan(normaliser: NormaliserName) -> None:
    zeros = torch.zeros(10)
    distances, guarded = next_state_distance(zeros, zeros, normaliser)
    assert torch.equal(distances, zeros)
    assert guarded > 0
