"""The numbers that one run is judged by: greedy returns of its policies, and which one to take.

Deployment k is acted in by pi_{k-1}. The recommended policy is the one that acted in the deployment
whose own rewards were the best: pi_K, which is never deployed, cannot be recommended.
"""

from collections.abc import Callable

import numpy as np

from otc_dist.comparison.scores import Run


def returns(run: Run) -> list[float]:
    """Mean greedy return of pi_0 .. pi_K."""
    return [float(np.mean(evaluation.returns)) for evaluation in run.evaluations]


def recommended(run: Run) -> float | None:
    """The greedy return of the recommended policy; None if a deployment could not be measured."""
    return None if run.best is None else returns(run)[run.best - 1]


def over_deployments(run: Run) -> float:
    """The mean over pi_1 .. pi_K."""
    return float(np.mean(returns(run)[1:]))


def worst_deployed(run: Run) -> float:
    """The least of pi_0 .. pi_{K-1}, which acted in deployments 1..K."""
    return min(returns(run)[:-1])


RECOMMENDED, MEAN, WORST = "recommended", "mean", "worst"
GAINS = (RECOMMENDED, MEAN)  # what is also held against pi_0
JUDGED: dict[str, Callable[[Run], float | None]] = {
    RECOMMENDED: recommended,
    MEAN: over_deployments,
    WORST: worst_deployed,
}
