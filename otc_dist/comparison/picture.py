"""One picture of a comparison, for documents: what is recommended after each deployment."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from otc_dist.comparison.arms import NULL
from otc_dist.comparison.colours import colours
from otc_dist.comparison.judgement import returns
from otc_dist.comparison.scores import Run, best_of
from otc_dist.report.svg import STYLE, Series, line_chart
from otc_dist.run.measured_returns import standard_error

# The page's colours, for a picture that stands alone.
_SCHEMES = """
:root { --text: #1b2430; --muted: #5b6775; --line: #dfe3e8; --card: #ffffff; }
@media (prefers-color-scheme: dark) {
:root { --text: #e6eaef; --muted: #9aa6b3; --line: #2c353f; --card: #1a2027; } }
"""


def so_far(run: Run) -> list[float]:
    """Greedy return (K,) of the policy that is recommended after deployment 1 .. K; NaN where one
    could not be measured.
    """
    greedy = returns(run)
    bests = [best_of(run.measured[: k + 1]) for k in range(len(run.measured))]
    return [math.nan if best is None else greedy[best - 1] for best in bests]


def picture(runs: Mapping[str, Sequence[Run]], title: str) -> str:
    """An SVG file's content: the mean over seeds of each arm, of several ± its standard
    error.
    """
    series, by_arm = [], colours(runs)
    for arm, found in runs.items():
        values = np.array([so_far(run) for run in found])
        mean = values.mean(axis=0)
        x = list(range(1, len(mean) + 1))
        low, high = None, None  # of one seed
        if len(values) > 1:
            error = standard_error(values)
            low, high = (mean - error).tolist(), (mean + error).tolist()
        style = (by_arm[arm], arm == NULL)
        series.append(Series(arm, x, mean.tolist(), low, high, "band", True, *style))
    chart = line_chart(
        series,
        title=title,
        x_label="deployments made (after one, pi_0 is all that is known)",
        y_label="return of the recommended policy",
    )
    namespace = '<svg xmlns="http://www.w3.org/2000/svg"'
    styled = f"<style>{_SCHEMES}{STYLE}</style>"
    return chart.replace("<svg", namespace, 1).replace("<title>", f"{styled}<title>", 1) + "\n"
