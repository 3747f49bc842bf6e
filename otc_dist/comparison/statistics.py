"""What raw scores show: spreads over seeds, and paired differences with bootstrap intervals."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.comparison.scores import Run
from otc_dist.randomness import stream
from otc_dist.transitions import Float64

RESAMPLES = 10_000
LEVEL = 0.95
ENOUGH = 10  # seeds for any claim

Normalise = Callable[[float], float | None]


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation over seeds (ddof 1; NaN for one seed)."""

    mean: float
    std: float

    @classmethod
    def of(cls, values: Float64) -> "Spread":
        """Of one value a seed."""
        finite = len(values) > 0 and bool(np.isfinite(values).all())
        many = finite and len(values) > 1
        return cls(
            float(values.mean()) if finite else np.nan,
            float(values.std(ddof=1)) if many else np.nan,
        )


@dataclass(frozen=True)
class Difference:
    """An arm minus the reference, seed by seed: their mean and its bootstrap interval."""

    seeds: list[float]  # one difference a seed
    mean: float
    low: float  # NaN for one seed
    high: float

    @classmethod
    def of(cls, differences: Float64) -> "Difference":
        low, high = bootstrap(differences)
        return cls(differences.tolist(), float(differences.mean()), low, high)


@dataclass(frozen=True)
class Measure:
    """One measure of one arm, over seeds."""

    deployments: list[Spread]  # of pi_0 .. pi_K
    over_deployments: Spread  # of the mean over deployments 1..K


@dataclass(frozen=True)
class Arm:
    """What one arm showed.

    `measures` are `return`, `improvement` (percent of |R_0|: it explodes near R_0 = 0), where the
    task has reference returns `normalised score` and `gain` (in normalised score, over pi_0), and
    where its episodes are won or lost `success` (percent won).
    """

    name: str
    measures: dict[str, Measure]
    # Returns minus the reference's; of the reference itself, empty and None.
    differences: list[Difference]  # at deployments 1..K
    over_deployments: Difference | None  # of the mean over deployments 1..K

    @property
    def last(self) -> Difference | None:
        """At the last deployment."""
        return self.differences[-1] if self.differences else None


@dataclass(frozen=True)
class Summary:
    """A comparison of the seeds that are complete for all arms."""

    seeds: list[int]
    episodes: int  # behind every return
    arms: list[Arm]
    conclusion: str

    def arm(self, name: str) -> Arm:
        """The arm of that name."""
        return next(arm for arm in self.arms if arm.name == name)


def bootstrap(values: Float64) -> tuple[float, float]:
    """95% percentile interval of the mean, from 10,000 resamples by a fixed stream.

    The same resamples of seeds for all arms. With few values it is too narrow: at five, it holds
    the truth about 85 times in 100.
    """
    count = len(values)
    if count < 2:
        return np.nan, np.nan
    chosen = stream(0, "bootstrap", count).integers(0, count, (RESAMPLES, count))
    tail = 50 * (1 - LEVEL)
    low, high = np.percentile(values[chosen].mean(axis=1), [tail, 100 - tail])
    return float(low), float(high)


def summarise(runs: Mapping[str, Sequence[Run]], normalise: Normalise) -> Summary:
    """Compare the arms on the seeds for which all of them have a run.

    Args:
        runs: arm -> its finished runs; REFERENCE and NULL among the arms.
        normalise: a return's normalised score, None for a task without reference returns.

    Raises:
        ValueError: no seed is complete.
    """
    common = set.intersection(*({run.seed for run in found} for found in runs.values()))
    seeds = sorted(common)
    if not seeds:
        raise ValueError("no seed is complete for all arms")
    returns = {
        name: np.array([_returns(run) for run in sorted(found, key=_seed) if run.seed in common])
        for name, found in runs.items()
    }
    reference = returns[REFERENCE]
    arms = []
    for name, values in returns.items():
        measures = _measures(values, normalise)
        if (won := _successes(runs[name], seeds)) is not None:
            measures["success"] = _measure(won)
        if name == REFERENCE:
            arms.append(Arm(name, measures, [], None))
            continue
        paired = (values - reference)[:, 1:]
        differences = [Difference.of(column) for column in paired.T]
        arms.append(Arm(name, measures, differences, Difference.of(paired.mean(axis=1))))
    episodes = min(
        len(evaluation.returns)
        for found in runs.values()
        for run in found
        if run.seed in common
        for evaluation in run.evaluations
    )
    return Summary(seeds, episodes, arms, conclude(arms, len(seeds)))


def _seed(run: Run) -> int:
    return run.seed


def _returns(run: Run) -> list[float]:
    """Mean return of pi_0 .. pi_K."""
    return [float(np.mean(evaluation.returns)) for evaluation in run.evaluations]


def _measures(returns: Float64, normalise: Normalise) -> dict[str, Measure]:
    """All measures of returns (seeds, K + 1)."""
    first = returns[:, :1]
    with np.errstate(divide="ignore", invalid="ignore"):
        improvement = 100 * (returns - first) / np.abs(first)
    values = {"return": returns, "improvement": improvement}
    if normalise(0.0) is not None:
        scores = np.vectorize(normalise, otypes=[np.float64])(returns)
        values |= {"normalised score": scores, "gain": scores - scores[:, :1]}
    return {name: _measure(array) for name, array in values.items()}


def _measure(values: Float64) -> Measure:
    """Of one value a seed and policy, (seeds, K + 1)."""
    return Measure(
        [Spread.of(column) for column in values.T], Spread.of(values[:, 1:].mean(axis=1))
    )


def _successes(runs: Sequence[Run], seeds: Sequence[int]) -> Float64 | None:
    """Percent of the episodes won, (seeds, K + 1); None where the task has no such thing."""
    found = [
        [evaluation.success for evaluation in run.evaluations]
        for run in sorted(runs, key=_seed)
        if run.seed in seeds
    ]
    return None if any(None in of_run for of_run in found) else np.array(found, np.float64)


def conclude(arms: Sequence[Arm], seeds: int) -> str:
    """One sentence on the means over deployments, which claims nothing that chance also does.

    An arm is said to differ if the interval of its difference leaves out zero and its mean
    difference lies outside the null arm's interval; and only with ENOUGH seeds.
    """
    found = {arm.name: arm.over_deployments for arm in arms if arm.over_deployments}
    null = found.pop(NULL)
    chance = f"the null arm, which differs by chance alone, by {interval(null)}"
    if seeds < ENOUGH:
        count = "1 seed is" if seeds == 1 else f"{seeds} seeds are"
        return f"{count} too few for any claim (ten are needed): {chance}."
    told = []
    for name, difference in found.items():
        beyond = difference.mean > max(null.high, 0) or difference.mean < min(null.low, 0)
        if beyond and (difference.low > 0 or difference.high < 0):
            better = "better" if difference.mean > 0 else "worse"
            told.append(f"{name} was {better} than {REFERENCE} by {interval(difference)}")
    if not told:
        return f"No arm differs from {REFERENCE} by more than chance does; {chance}."
    return f"Over the deployments, {', '.join(told)}; {chance}; other arms: no claim."


def interval(difference: Difference) -> str:
    """`+12.3 [-4.5, 29.1]`."""
    if np.isnan(difference.low):
        return f"{difference.mean:+.1f}"
    return f"{difference.mean:+.1f} [{difference.low:+.1f}, {difference.high:+.1f}]"
