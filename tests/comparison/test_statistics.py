import math

import numpy as np
import pytest
from scipy import stats

from otc_dist.comparison import tables
from otc_dist.comparison.arms import NULL, PERFECT, REFERENCE
from otc_dist.comparison.intervals import Difference, bootstrap, interquartile_mean
from otc_dist.comparison.judgement import recommended
from otc_dist.comparison.picture import so_far
from otc_dist.comparison.score_statistics import Summary, summarise
from otc_dist.comparison.scores import Evaluation, Run, best_of
from otc_dist.run.measured_returns import Measured


def run(arm: str, seed: int, *means: float, offline: str = "") -> Run:
    """A run whose evaluations have these mean returns, and its deployments estimates as high."""
    evaluations = [Evaluation([m - 1, m + 1], [5, 5], {}) for m in means]
    measured: list[Measured | None] = [Measured(m, 1.0, 9) for m in means[:-1]]
    return Run(
        arm, seed, "", evaluations, offline, measured=measured, horizon=5, best=best_of(measured)
    )


def compare(**returns: list[list[float]]) -> Summary:
    """Returns of pi_0 .. pi_K, of seeds 0, 1, ... of each arm."""
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
    assert arm.last.values == [30, 70] and arm.last.mean == 50
    assert arm.over_deployments.values == [25, 45]
    # Two seeds: resampled means are 25, 35 or 45, the ends each a quarter of the time.
    assert (arm.over_deployments.low, arm.over_deployments.high) == (25, 45)
    assert summary.arm(REFERENCE).last is None


def test_a_difference_is_over_the_seeds_that_both_sides_have() -> None:
    runs = {
        REFERENCE: [run(REFERENCE, 2, 1, 2), run(REFERENCE, 0, 1, 3)],
        NULL: [run(NULL, 0, 1, 4), run(NULL, 1, 1, 9)],
        "alone": [run("alone", 7, 1, 5)],
        "none": [],
    }
    summary = summarise(runs, lambda value: None)
    assert summary.seeds == [0, 2] and [arm.name for arm in summary.arms] == list(runs)[:3]
    null = summary.arm(NULL)
    assert null.last is not None and (null.last.seeds, null.last.values) == ([0], [1])
    assert null.seeds == [0, 1] and null.measures["return"].deployments[1].mean == 6.5
    assert summary.arm("alone").last is None and summary.arm("alone").over_deployments is None
    assert "normalised score" not in null.measures
    text = "\n".join(tables.text(summary))
    assert "1 of 1 seeds" in text
    seeds = next(line for line in text.splitlines() if line.startswith("seeds"))
    assert seeds.split() == ["seeds", "2", "2", "1"]
    with pytest.raises(ValueError, match="no seed of uniform"):
        summarise({NULL: runs[NULL]}, lambda value: None)


def test_the_recommended_policy_is_the_one_whose_deployment_was_best() -> None:
    """Not the best evaluated one, and never pi_K, which was not deployed."""
    measured: list[Measured | None] = [Measured(m, 1.0, 9) for m in (1.0, 3.0, 2.0)]
    returns = [100.0, 120.0, 300.0, 900.0]
    evaluations = [Evaluation([value] * 2, [5, 5], {}) for value in returns]
    one = Run(REFERENCE, 0, "", evaluations, measured=measured, horizon=5, best=best_of(measured))
    arm = summarise({REFERENCE: [one]}, lambda value: None).arm(REFERENCE)
    assert arm.judged["recommended"].spread.mean == 120
    assert arm.judged["worst"].spread.mean == 100
    assert arm.judged["mean"].spread.mean == (120 + 300 + 900) / 3
    assert {name: gain.difference.values for name, gain in arm.gains.items()} == {
        "recommended": [20],
        "mean": [(120 + 300 + 900) / 3 - 100],
    }
    assert arm.gains["recommended"].median == 20


def test_what_runs_are_judged_by_is_compared_seed_by_seed() -> None:
    summary = compare(
        otc_value=[[100.0, 150.0, 10.0], [200.0, 180.0, 0.0]],
        uniform=[[100.0, 110.0, 120.0], [200.0, 210.0, 190.0]],
        uniform_null=[[100.0, 90.0, 118.0], [200.0, 204.0, 188.0]],
    )
    found = {
        name: (judged.difference.values if judged.difference else None)
        for name, judged in summary.arm("otc-value").judged.items()
    }
    assert found == {"recommended": [40, -10], "mean": [80 - 115, 90 - 200], "worst": [0, -20]}
    gains = summary.arm("otc-value").gains
    assert {name: (one.difference.above, one.median) for name, one in gains.items()} == {
        "recommended": (1, 25),
        "mean": (0, (-20 - 55) / 2),
    }
    assert summary.arm(REFERENCE).judged["recommended"].difference is None


def test_a_run_whose_deployments_were_not_measured_recommends_nothing() -> None:
    runs = {
        REFERENCE: [Run(REFERENCE, 0, "", run(REFERENCE, 0, 1, 2).evaluations, measured=[None])]
    }
    summary = summarise(runs, lambda value: None)
    assert list(summary.arms[0].judged) == ["mean", "worst"] and list(summary.arms[0].gains) == [
        "mean"
    ]
    assert "recommended policy" not in "\n".join(tables.text(summary)).split("By the")[0]


def ceiling(height: float, noise: float) -> Summary:
    """Perfect correction on three of ten seeds, a fourth of it by one arm."""
    quarter = [[100.0, 100.0 + 25 + seed, 0.0] for seed in range(10)]
    perfect = [[100.0, 100.0 + height + noise * (-1) ** seed, 0.0] for seed in range(3)]
    return compare(
        perfect=perfect,
        otc_value=quarter,
        uniform=[[100.0, 100.0, 0.0]] * 10,
        uniform_null=[[100.0, 100.0, 0.0]] * 10,
    )


def test_the_share_of_the_way_to_perfect_correction() -> None:
    judged = ceiling(104, 1).arm("otc-value").judged["recommended"]
    height = (105 + 103 + 105) / 3
    assert judged.share == pytest.approx(26 / height)  # of seeds 0, 1 and 2: those of all three
    text = "\n".join(tables.text(ceiling(104, 1)))
    assert "of the way" in text and "25%" in text
    assert ceiling(104, 1).arm(PERFECT).judged["recommended"].share is None


def test_there_is_no_way_where_perfect_correction_is_not_known_to_be_better() -> None:
    for summary in (ceiling(104, 104), ceiling(-104, 1)):
        assert all(arm.judged["recommended"].share is None for arm in summary.arms)
    assert "of the way" not in "\n".join(tables.text(ceiling(104, 104)))


def test_other_offline_policies_are_marked() -> None:
    runs = {
        REFERENCE: [run(REFERENCE, 0, 1, 2, offline="a")],
        NULL: [run(NULL, 0, 1, 2, offline="a")],
        "other": [run("other", 0, 5, 6, offline="b")],
    }
    summary = summarise(runs, lambda value: None)
    assert [arm.own_pi_0 for arm in summary.arms] == [False, False, True]
    assert "other *own pi_0*" in "\n".join(tables.text(summary))


def test_the_interquartile_mean_by_hand() -> None:
    assert interquartile_mean(np.array([9.0, 1.0, 2.0, 100.0])) == 5.5
    assert interquartile_mean(np.array([1.0, 2.0, 6.0])) == 3
    values = np.random.default_rng(0).standard_normal(10)
    assert interquartile_mean(values) == pytest.approx(stats.trim_mean(values, 0.25))


@pytest.mark.parametrize("count", [2, 5, 10])
def test_the_other_interval_is_students(count: int) -> None:
    values = np.random.default_rng(count).normal(3.0, 2.0, count)
    found = Difference.of(dict(enumerate(values)))
    error = values.std(ddof=1) / math.sqrt(count)
    low, high = stats.t.interval(0.95, count - 1, values.mean(), error)
    assert (found.t_low, found.t_high) == (pytest.approx(low), pytest.approx(high))


def test_the_interval_is_that_of_the_normal_distribution_for_many_seeds() -> None:
    values = np.random.default_rng(0).standard_normal(400)
    low, high = bootstrap(values)
    half = 1.96 * values.std() / math.sqrt(400)
    assert low == pytest.approx(values.mean() - half, abs=0.01)
    assert high == pytest.approx(values.mean() + half, abs=0.01)
    assert bootstrap(values) == (low, high)  # a fixed stream


def test_equal_values_have_an_interval_of_no_width(recwarn: pytest.WarningsRecorder) -> None:
    found = Difference.of({0: 3.0, 1: 3.0, 2: 3.0})
    assert (found.low, found.high, found.t_low, found.t_high) == (3, 3, 3, 3)
    assert not recwarn.list


def test_one_seed_has_no_interval() -> None:
    found = Difference.of({4: 3.0})
    assert found.mean == 3 and all(
        math.isnan(x) for x in (found.low, found.high, found.t_low, found.t_high)
    )
    assert str(found) == "+3.0" and found.student == "-" and not found.excludes_zero


def steady(gain: float, seeds: int, noise: float = 1.0) -> list[list[float]]:
    """Two deployments whose differences from 100 are `gain`, a little more or less each seed."""
    return [
        [100.0, *[100 + gain + noise * (-1) ** seed * (1 + seed / 10)] * 2] for seed in range(seeds)
    ]


def test_few_seeds_claim_nothing() -> None:
    summary = compare(otc_value=steady(50, 5), uniform=steady(0, 5, 0), uniform_null=steady(0, 5))
    assert "too few for any claim" in summary.conclusion
    assert ": by chance alone, the null arm differs by " in summary.conclusion
    assert "better" not in summary.conclusion


def test_an_arm_of_few_seeds_claims_nothing() -> None:
    summary = compare(
        otc_value=steady(50, 3),
        online_only=steady(-50, 10),
        uniform=steady(0, 10, 0),
        uniform_null=steady(0, 10),
    )
    assert "online-only was worse" in summary.conclusion
    assert "otc-value" not in summary.conclusion


def test_without_a_null_arm_nothing_is_claimed() -> None:
    conclusion = compare(otc_value=steady(50, 10), uniform=steady(0, 10, 0)).conclusion
    assert "no claim without the null arm" in conclusion and "better" not in conclusion


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
    assert "no arm differs from uniform by more than chance does" in summary.conclusion


def test_what_is_recommended_after_each_deployment_is_the_best_so_far() -> None:
    found = run("uniform", 0, 100.0, 300.0, 200.0, 400.0)  # deployments measure pi_0 .. pi_2
    assert so_far(found) == [100.0, 300.0, 300.0]
    assert so_far(found)[-1] == recommended(found)
