"""Several data sets together: interquartile means, probabilities, differences.

As Agarwal et al. (2021) have it: seeds are resampled within each data set (a stratified bootstrap),
so that every data set counts the same. What is pooled is in a unit that data sets share, normalised
score; or in return, which tasks without one may share, as for several numbers of agents.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isnan

import numpy as np

from otc_dist.comparison.arms import REFERENCE
from otc_dist.comparison.campaign.found import Found
from otc_dist.comparison.intervals import Difference, stratified
from otc_dist.comparison.judgement import returns
from otc_dist.comparison.scores import Run
from otc_dist.report.return_statistics import interquartile_mean
from otc_dist.transitions import Float64

Judge = Callable[[Run], float | None]  # a run -> a return


def last(run: Run) -> float:
    """Of pi_K, which was tuned on all deployments and is never deployed."""
    return returns(run)[-1]


@dataclass(frozen=True)
class Estimate:
    """A number, and its 95% interval by the stratified bootstrap: NaN for one seed a data set."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        around = "" if isnan(self.low) else f" [{self.low:+,.1f}, {self.high:+,.1f}]"
        return f"{self.value:+,.1f}{around}"

    @property
    def percent(self) -> str:
        """As a probability."""
        around = "" if isnan(self.low) else f" [{self.low:.0%}, {self.high:.0%}]"
        return f"{self.value:.0%}{around}"


def gains(found: Found, arm: str, judge: Judge) -> dict[int, float]:
    """Seed -> what `judge` finds above pi_0, as `Found.gain`."""
    values = {seed: (judge(run), returns(run)[0]) for seed, run in found.runs(arm).items()}
    return {
        seed: found.gain(value, first)
        for seed, (value, first) in values.items()
        if value is not None
    }


def iqm(several: Sequence[Found], arm: str, judge: Judge) -> Estimate | None:
    """The interquartile mean of the gains of all runs; None if a data set has none."""
    strata = [np.array(list(gains(one, arm, judge).values())) for one in several]
    return _estimate(strata, _iqm) if all(map(len, strata)) else None


def improving(several: Sequence[Found], arm: str) -> Estimate | None:
    """The probability that a run of the arm is better, by its last policy, than one of the
    reference on the same data set, the mean over the data sets; None if one has no such runs.
    """
    pairs = [
        np.array(list(gains(one, name, last).values()))
        for name in (arm, REFERENCE)
        for one in several
    ]
    return _estimate(pairs, _better) if all(map(len, pairs)) else None


def difference(
    several: Sequence[Found], arm: str, other: str, judge: Judge = last
) -> Difference | None:
    """One arm minus another, seed by seed: the mean over the data sets, for the seeds that all of
    them have; None if there is none.
    """
    of_each = [(gains(one, arm, judge), gains(one, other, judge)) for one in several]
    common = set.intersection(*(set(mine) & set(theirs) for mine, theirs in of_each))
    if not common:
        return None
    return Difference.of(
        {
            seed: float(np.mean([mine[seed] - theirs[seed] for mine, theirs in of_each]))
            for seed in common
        }
    )


def _estimate(strata: Sequence[Float64], statistic: Callable[..., Float64]) -> Estimate:
    return Estimate(float(statistic(*strata)), *stratified(strata, statistic))


def _iqm(*strata: Float64, axis: int = -1) -> Float64:
    """Over all runs of all data sets, without the lowest and the highest quarter of them."""
    return interquartile_mean(np.concatenate(strata, axis), axis)


def _better(*strata: Float64, axis: int = -1) -> Float64:
    """Of the first half of the strata over the second: a tie counts as half."""
    half = len(strata) // 2
    shares = []
    for mine, others in zip(strata[:half], strata[half:], strict=True):
        mine, others = np.moveaxis(mine, axis, -1), np.moveaxis(others, axis, -1)
        above = np.sign(mine[..., :, None] - others[..., None, :])
        shares.append((1 + above.mean(axis=(-2, -1))) / 2)
    found: Float64 = np.mean(shares, axis=0)
    return found
