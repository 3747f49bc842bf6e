import math

import numpy as np
import pytest

from otc_dist.comparison import tables
from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.comparison.scores import Evaluation, Run
from otc_dist.comparison.statistics import Difference, Summary, bootstrap, summarise


def run(arm: str, seed: int, *means: float) -> Run:
    """A run whose evaluations have these mean returns."""
    return Run(arm, seed, "", [Evaluation([m - 1, m + 1], [5, 5], {}) for m in means])


def compare(**returns: list[list[float]]) -> Summary:
    """Returns of pi_0 .. pi_K, seed by seed, of each arm."""
    runs = {
        name.replace("_", "-"): [
            run(name.replace("_", "-"), seed, *of_seed) for seed, of_seed in enumerate(seeds)
        ]
        for name, seeds in returns.items()
    }
    return summarise(runs, lambda value: value / 10)


SMALL = {
    "otc_value": [[100.0, 130.0, 150.0], [200.0, 220.0, 260.0]],
    "uniform": [[100.0, 110.0, 120.0], [200.0, 200.0, 190.0]],
    "uniform_null": [[100.0, 112.0, 118.0], [200.0, 204.0, 188.0]],
}


def test_measures_by_hand() -> None:
    arm = compare(**SMALL).arm("otc-value")
    returns = arm.measures["return"]
    assert [spread.mean for spread in returns.deployments] == [150, 175, 205]
    assert returns.deployments[2].std == pytest.approx(math.sqrt(2 * 55**2))  # 150 and 260, ddof 1
    assert returns.over_deployments.mean == (140 + 240) / 2
    improvement = arm.measures["improvement"]
    assert improvement.deployments[2].mean == pytest.approx((50 + 30) / 2)
    assert improvement.over_deployments.mean == pytest.approx((40 + 20) / 2)
    assert arm.measures["normalised score"].deployments[0].mean == 15
    assert arm.measures["gain"].deployments[2].mean == pytest.approx((5 + 6) / 2)


def test_episodes_won_are_told_where_a_task_has_them() -> None:
    won = {"uniform": [[True, False], [True, True]], "uniform-null": [[False, False], [False] * 2]}
    runs = {
        name: [
            Run(name, seed, "", [Evaluation([1, 2], [5, 5], {}, of_policy) for of_policy in found])
            for seed in (0, 1)
        ]
        for name, found in won.items()
    }
    summary = summarise(runs, lambda value: None)
    measure = summary.arm("uniform").measures["success"]
    assert [spread.mean for spread in measure.deployments] == [50, 100]
    assert measure.over_deployments.mean == 100
    assert "episodes won (%), mean ± std over seeds" in "\n".join(tables.text(summary))
    assert "episodes won" not in "\n".join(tables.text(compare(**SMALL)))


def test_improvement_is_relative_to_the_size_of_the_offline_return() -> None:
    summary = compare(uniform=[[-50.0, -25.0]], uniform_null=[[-50.0, -75.0]])
    assert summary.arm("uniform").measures["improvement"].deployments[1].mean == 50
    assert summary.arm(NULL).measures["improvement"].deployments[1].mean == -50


def test_paired_differences_by_hand() -> None:
    summary = compare(**SMALL)
    arm = summary.arm("otc-value")
    assert arm.last is not None and arm.over_deployments is not None
    assert arm.last.seeds == [30, 70] and arm.last.mean == 50
    assert arm.over_deployments.seeds == [25, 45]
    # Two seeds: resampled means are 25, 35 or 45, the ends each a quarter of the time.
    assert (arm.over_deployments.low, arm.over_deployments.high) == (25, 45)
    assert summary.arm(REFERENCE).last is None


def test_only_seeds_complete_for_all_arms_count() -> None:
    runs = {
        REFERENCE: [run(REFERENCE, 2, 1, 2), run(REFERENCE, 0, 1, 3)],
        NULL: [run(NULL, 0, 1, 4), run(NULL, 1, 1, 9)],
    }
    summary = summarise(runs, lambda value: None)
    assert summary.seeds == [0]
    null = summary.arm(NULL).last
    assert null is not None and null.seeds == [1]
    assert "normalised score" not in summary.arm(NULL).measures
    with pytest.raises(ValueError, match="no seed"):
        summarise({REFERENCE: runs[REFERENCE][:1], NULL: runs[NULL]}, lambda value: None)


def test_the_interval_is_that_of_the_normal_distribution_for_many_seeds() -> None:
    values = np.random.default_rng(0).standard_normal(400)
    low, high = bootstrap(values)
    half = 1.96 * values.std() / math.sqrt(400)
    assert low == pytest.approx(values.mean() - half, abs=0.01)
    assert high == pytest.approx(values.mean() + half, abs=0.01)
    assert bootstrap(values) == (low, high)  # a fixed stream


def test_one_seed_has_no_interval() -> None:
    difference = Difference.of(np.array([3.0]))
    assert difference.mean == 3 and math.isnan(difference.low) and math.isnan(difference.high)


def steady(gain: float, seeds: int, noise: float = 1.0) -> list[list[float]]:
    """Two deployments whose differences from 100 are `gain`, a little more or less each seed."""
    return [
        [100.0, *[100 + gain + noise * (-1) ** seed * (1 + seed / 10)] * 2] for seed in range(seeds)
    ]


def test_few_seeds_claim_nothing() -> None:
    summary = compare(otc_value=steady(50, 5), uniform=steady(0, 5, 0), uniform_null=steady(0, 5))
    assert "too few for any claim" in summary.conclusion
    assert "better" not in summary.conclusion


def test_a_clear_gain_is_claimed_and_a_small_one_is_not() -> None:
    summary = compare(
        otc_value=steady(50, 10),
        online_only=steady(-50, 10),
        otc_embedding=steady(0.1, 10),
        uniform=steady(0, 10, 0),
        uniform_null=steady(0, 10),
    )
    assert "otc-value was better than uniform by +5" in summary.conclusion
    assert "online-only was worse than uniform by -5" in summary.conclusion
    assert "otc-embedding" not in summary.conclusion


def test_no_gain_is_claimed_that_the_null_arm_also_shows() -> None:
    summary = compare(
        otc_value=steady(50, 10), uniform=steady(0, 10, 0), uniform_null=steady(60, 10)
    )
    assert "No arm differs from uniform by more than chance does" in summary.conclusion
