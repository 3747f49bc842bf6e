"""What a run's deployments measured, which policy it recommends, and whether it ended early."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass

from otc_dist.report import html
from otc_dist.report.axes import Range
from otc_dist.report.numbers import NOTHING, column, columns, number
from otc_dist.report.return_statistics import Spread
from otc_dist.report.run_data import RunData
from otc_dist.report.svg import Reference, Series, line_chart
from otc_dist.run import recommendation
from otc_dist.run.measured_returns import Measured


@dataclass(frozen=True)
class Estimate:
    """What one deployment measured of the policy that acted in it."""

    deployment: int
    policy: int  # k of pi_k
    mean: float  # return of the first `horizon` steps of an episode
    error: float  # standard error of the mean
    episodes: int
    horizon: int
    greedy_return: float | None  # of the same policy's evaluation; of whole episodes
    reverted_to: int | None  # the policy that tuning continued from, if it was another one


def estimates(run: RunData) -> list[Estimate]:
    """One a deployment that measured something."""
    reverts, known = run.description.deployment.revert, _known(run)
    return [
        Estimate(
            k,
            k - 1,
            **asdict(found),
            horizon=run.horizon,
            greedy_return=greedy_return(run, k - 1),
            reverted_to=recommendation.reverted(known[:k])
            if reverts and k <= min(len(known), run.description.deployment.count)
            else None,
        )
        for k, found in sorted(run.measured.items())
    ]


def _known(run: RunData) -> list[Measured]:
    """Of the deployments up to the first that measured nothing, or whose log is damaged."""
    known: list[Measured] = []
    while (found := run.measured.get(len(known) + 1)) is not None:
        known.append(found)
    return known


def greedy_return(run: RunData, policy: int) -> float | None:
    """Mean return of a policy's evaluation, if it was evaluated."""
    for evaluation in run.evaluations:
        if evaluation.deployment == policy and evaluation.returns:
            return sum(evaluation.returns) / len(evaluation.returns)
    return None


def recommended(run: RunData) -> dict[str, object] | None:
    """Of results.json; of a run that goes on, the best so far. None: nothing can be said yet."""
    settings, table = run.description.deployment, estimates(run)
    keep = settings.keep or "last"
    if not (run.complete or (keep == "best" and table)):
        return None
    measured = [run.measured.get(k) for k in range(1, run.deployments + 1)]
    if keep == "best":
        measured = list(_known(run))
    found = recommendation.recommended(keep, measured, min(run.deployments, settings.count))
    one = next((row for row in table if row.deployment == found.deployment), None)
    return {
        "deployment": found.deployment,
        "policy": found.policy,
        "mean": one and one.mean,
        "error": one and one.error,
        "episodes": one and one.episodes,
        "horizon": one and one.horizon,
        "keep": keep,
        "greedy_return": greedy_return(run, found.policy),
        "checkpoints": {
            agent.name: str(
                run.folder.checkpoint(agent.name, found.policy).relative_to(run.folder.root)
            )
            for agent in run.agents
        },
    }


def stopped(run: RunData) -> dict[str, object] | None:
    """Of results.json: after which deployment none followed, and why; None if all were made."""
    floor, found = run.description.deployment.floor, run.measured.get(run.deployments)
    if found is None or not run.ended_by_floor:
        return None
    return {
        "deployment": run.deployments,
        "reason": f"deployment {run.deployments} measured {number(found.mean)}, below"
        f" deployment.floor = {number(floor or 0.0)}",
        "floor": floor,
        "measured": found.mean,
    }


def went_back(measured: Iterable[tuple[int, int | None]]) -> str:
    """Which policies come from another than the one before them, in a sentence; "": none does.

    Args:
        measured: every deployment with what tuning after it went back to (`Estimate.reverted_to`).
    """
    pairs = [f"pi_{k} comes from pi_{policy}" for k, policy in measured if policy is not None]
    if not pairs:
        return ""
    return f"Tuning went back to the best policy deployed so far: {', '.join(pairs)}."


def named(recommended: Mapping[str, object]) -> str:
    """The recommended policy in words: `the policy of deployment 4, pi_3`."""
    if recommended["deployment"] is None:
        return f"the last tuned policy, pi_{recommended['policy']}, which was not deployed"
    return f"the policy of deployment {recommended['deployment']}, pi_{recommended['policy']}"


def returns_range(run: RunData) -> Range | None:
    """What the axes of all charts of returns hold, so that they can be compared; None: nothing."""
    values = [row.mean + way * row.error for row in estimates(run) for way in (-1, 1)]
    for one in run.evaluations:
        if one.returns:
            values += Spread.of(one.returns).band
    return (min(values), max(values)) if values else None


def section(run: RunData) -> str:
    """The estimates with their errors beside the greedy returns, as a chart and a table."""
    table = estimates(run)
    if not table:
        return ""
    ks, kept = [float(row.deployment) for row in table], recommended(run)
    floor, total = run.description.deployment.floor, run.description.deployment.total
    series = [
        Series(
            "measured, ±1 standard error",
            ks,
            [row.mean for row in table],
            [row.mean - row.error for row in table],
            [row.mean + row.error for row in table],
            spread="bars",
        ),
        Series(
            "greedy return of the same policy",
            ks,
            [float("nan") if row.greedy_return is None else row.greedy_return for row in table],
        ),
    ]
    chart = html.chart(
        lambda width, height: line_chart(
            series,
            title="Of the policy that acted in each deployment",
            x_label="deployment",
            y_label="return",
            references=[] if floor is None else [Reference("floor", floor)],
            x_range=(0, total),
            y_range=returns_range(run),
            width=width,
            height=height,
        )
    )
    measured, errors = columns((row.mean for row in table), (row.error for row in table))
    listed = {
        "deployment": [
            f"{row.deployment}{' (recommended)' if kept and _is(row, kept) else ''}"
            for row in table
        ],
        "policy": [f"pi_{row.policy}" for row in table],
        "measured": measured,
        "± error": errors,
        "episodes": [str(row.episodes) for row in table],
        "greedy return": column(row.greedy_return for row in table),
    }
    if any(row.reverted_to is not None for row in table):
        listed["tuning continued from"] = [
            NOTHING if row.reverted_to is None else f"pi_{row.reverted_to}" for row in table
        ]
    note = (
        f"The mean return of the first {run.horizon} steps of every episode that began at least as"
        " many steps before the deployment's end, with its standard error: from the data that the"
        " agents learn from, without a step more. Greedy returns are of whole episodes."
    )
    return html.section(
        "What deployments measured",
        chart,
        html.table(list(listed), zip(*listed.values(), strict=True)),
        html.note(note),
    )


def _is(row: Estimate, kept: Mapping[str, object]) -> bool:
    return row.deployment == kept["deployment"]
