"""What raw scores show: spreads over seeds, and paired differences from the reference.

Arms may have different seeds: an arm's spreads are over its own, and a difference is over the
seeds that both sides have.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from otc_dist.comparison.arms import PERFECT, REFERENCE
from otc_dist.comparison.conclusion import conclude
from otc_dist.comparison.intervals import Difference
from otc_dist.comparison.judgement import GAINS, JUDGED, MEAN, returns
from otc_dist.comparison.scores import Run
from otc_dist.report.return_statistics import Spread
from otc_dist.transitions import Float64

Normalise = Callable[[float], float | None]
BySeed = Mapping[int, float]


@dataclass(frozen=True)
class Measure:
    """One measure of one arm, over its seeds."""

    deployments: list[Spread]  # of pi_0 .. pi_K
    over_deployments: Spread  # of the mean over pi_1 .. pi_K


@dataclass(frozen=True)
class Judged:
    """One number that whole runs are judged by; see `judgement.JUDGED`."""

    seeds: list[int]  # those that have it
    spread: Spread
    difference: Difference | None  # from the reference; None of itself, or without a common seed
    # Of the way from the reference to perfect correction, on the seeds that all three have; None
    # where perfect correction is not known to be better.
    share: float | None = None


@dataclass(frozen=True)
class Gain:
    """What one of `judgement.GAINS` has over pi_0."""

    difference: Difference
    median: float  # percent of |R_0|; NaN where an R_0 is 0


@dataclass(frozen=True)
class Arm:
    """What one arm showed.

    Attributes:
        own_pi_0: whether it began from other offline policies than the reference.
        measures: `return`, `improvement` (percent of |R_0|: it explodes near R_0 = 0), where the
            task has reference returns `normalised score` and `gain` (in normalised score, over
            pi_0), and where its episodes are won or lost `success` (percent won).
        judged: by `judgement.JUDGED`; without `recommended` where no deployment was measured.
        gains: by `judgement.GAINS`; without `recommended` where no deployment was measured.
        differences: in return from the reference, at pi_1 .. pi_K; of the reference itself empty.
    """

    name: str
    own_pi_0: bool
    seeds: list[int]
    measures: dict[str, Measure]
    judged: dict[str, Judged]
    gains: dict[str, Gain]
    differences: list[Difference]

    @property
    def over_deployments(self) -> Difference | None:
        """From the reference, of the mean over pi_1 .. pi_K."""
        return self.judged[MEAN].difference

    @property
    def last(self) -> Difference | None:
        """From the reference, of pi_K."""
        return self.differences[-1] if self.differences else None


@dataclass(frozen=True)
class Summary:
    """A comparison of all arms with the reference."""

    seeds: list[int]  # the reference's
    episodes: int  # that every return is the mean of, at least
    arms: list[Arm]
    conclusion: str

    def arm(self, name: str) -> Arm:
        """The arm of that name."""
        return next(arm for arm in self.arms if arm.name == name)


def summarise(runs: Mapping[str, Sequence[Run]], normalise: Normalise) -> Summary:
    """Compare the arms.

    Args:
        runs: arm -> its finished runs, of as many deployments everywhere; REFERENCE among the arms.
        normalise: a return's normalised score, None for a task without reference returns.

    Raises:
        ValueError: the reference has no run.
    """
    held = {name: {run.seed: run for run in found} for name, found in runs.items() if found}
    if REFERENCE not in held:
        raise ValueError(f"no seed of {REFERENCE} is complete")
    arms = [_arm(name, held, normalise) for name in held]
    everything = [run for found in held.values() for run in found.values()]
    episodes = min(len(one.returns) for run in everything for one in run.evaluations)
    differences: dict[str, dict[str, Difference]] = {measure: {} for measure in JUDGED}
    for arm in arms:
        for measure, judged in arm.judged.items():
            if judged.difference:
                differences[measure][arm.name] = judged.difference
    return Summary(sorted(held[REFERENCE]), episodes, arms, conclude(differences))


def _arm(name: str, held: Mapping[str, Mapping[int, Run]], normalise: Normalise) -> Arm:
    mine, reference = held[name], held[REFERENCE]
    seeds = sorted(mine)
    common = [seed for seed in seeds if seed in reference]
    found = np.array([returns(mine[seed]) for seed in seeds])
    measures = _measures(found, normalise)
    if (won := _successes([mine[seed] for seed in seeds])) is not None:
        measures["success"] = _measure(won)
    differences = []
    if name != REFERENCE and common:
        for k in range(1, found.shape[1]):
            of_seed = {s: returns(mine[s])[k] - returns(reference[s])[k] for s in common}
            differences.append(Difference.of(of_seed))
    return Arm(
        name,
        any(mine[seed].offline != reference[seed].offline for seed in common),
        seeds,
        measures,
        _judged(name, held),
        _gains(mine.values()),
        differences,
    )


def _judged(name: str, held: Mapping[str, Mapping[int, Run]]) -> dict[str, Judged]:
    judged = {}
    for measure, judge in JUDGED.items():

        def of_arm(arm: str, judge: Callable[[Run], float | None] = judge) -> BySeed:
            values = {seed: judge(run) for seed, run in held.get(arm, {}).items()}
            return {seed: value for seed, value in values.items() if value is not None}

        mine, reference = of_arm(name), of_arm(REFERENCE)
        if mine:
            above = _minus(mine, reference) if name != REFERENCE else {}
            ceiling = _minus(of_arm(PERFECT), reference)
            judged[measure] = Judged(
                sorted(mine),
                Spread.of(np.array([mine[seed] for seed in sorted(mine)])),
                Difference.of(above) if above else None,
                _share(above, ceiling) if name != PERFECT else None,
            )
    return judged


def _minus(mine: BySeed, others: BySeed) -> BySeed:
    return {seed: value - others[seed] for seed, value in mine.items() if seed in others}


def _share(above: BySeed, ceiling: BySeed) -> float | None:
    """Of the way from the reference to perfect correction, both minus the reference."""
    common = [seed for seed in above if seed in ceiling]
    if not common:
        return None
    most = Difference.of({seed: ceiling[seed] for seed in common})
    if not (most.excludes_zero and most.mean > 0):
        return None
    return float(np.mean([above[seed] for seed in common])) / most.mean


def _gains(runs: Collection[Run]) -> dict[str, Gain]:
    gains = {}
    for measure in GAINS:
        found = {run.seed: (JUDGED[measure](run), returns(run)[0]) for run in runs}
        gained = {s: value - first for s, (value, first) in found.items() if value is not None}
        if gained:
            relative = [
                100 * gained[s] / abs(found[s][1]) if found[s][1] else math.nan for s in gained
            ]
            gains[measure] = Gain(Difference.of(gained), float(np.median(relative)))
    return gains


def _measures(found: Float64, normalise: Normalise) -> dict[str, Measure]:
    """All measures of returns (seeds, K + 1)."""
    first = found[:, :1]
    with np.errstate(divide="ignore", invalid="ignore"):
        improvement = 100 * (found - first) / np.abs(first)
    values = {"return": found, "improvement": improvement}
    if normalise(0.0) is not None:
        scores = np.vectorize(normalise, otypes=[np.float64])(found)
        values |= {"normalised score": scores, "gain": scores - scores[:, :1]}
    return {name: _measure(array) for name, array in values.items()}


def _measure(values: Float64) -> Measure:
    """Of one value a seed and policy, (seeds, K + 1)."""
    return Measure(
        [Spread.of(column) for column in values.T], Spread.of(values[:, 1:].mean(axis=1))
    )


def _successes(runs: Sequence[Run]) -> Float64 | None:
    """Percent of the episodes won, (seeds, K + 1); None where the task has no such thing."""
    found = [[evaluation.success for evaluation in run.evaluations] for run in runs]
    return None if any(None in of_run for of_run in found) else np.array(found, np.float64)
