"""`results.json`: the raw numbers of a run, and what the tables are computed from."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

from otc_dist.report import kept
from otc_dist.report.return_statistics import Spread, improvement
from otc_dist.report.run_data import Evaluation, RunData
from otc_dist.report.verdict import verdict

QUICK_LABEL = "a quick look, not a result"


@dataclass(frozen=True)
class Row:
    """One evaluation beside the offline one."""

    deployment: int
    returns: Spread
    score: float | None  # normalised, of the mean return
    length: float | None  # mean, steps
    success: float | None  # percent of the episodes won; None where the task has no such thing
    improvement: float | None = None  # percent of the offline return
    gain: float | None = None  # difference in normalised score to the offline one


def rows(run: RunData) -> list[Row]:
    """One row an evaluation, in order of deployments."""
    offline = offline_row(run)
    made = [_row(evaluation) for evaluation in run.evaluations]
    return [compare(row, offline) for row in made if row is not None]


def offline_row(run: RunData) -> Row | None:
    """The evaluation of pi_0, if it is there."""
    return next((_row(e) for e in run.evaluations if e.deployment == 0), None)


def _row(evaluation: Evaluation) -> Row | None:
    if not evaluation.returns:
        return None
    lengths, won = evaluation.lengths, evaluation.successes
    return Row(
        evaluation.deployment,
        Spread.of(evaluation.returns),
        evaluation.normalised_score,
        sum(lengths) / len(lengths) if lengths else None,
        100.0 * sum(won) / len(won) if won else None,
    )


def compare(row: Row, offline: Row | None) -> Row:
    """The row with its improvement over the offline one; the offline row itself has none."""
    if offline is None or row.deployment == 0:
        return row
    return replace(
        row,
        improvement=improvement(row.returns.mean, offline.returns.mean),
        gain=_difference(row.score, offline.score),
    )


@dataclass(frozen=True)
class Tuned:
    """What tuning brought: the last deployment, and the mean over all of them."""

    last: Row
    mean_return: float
    mean_score: float | None
    mean_success: float | None  # percent
    improvement: float | None  # of the mean over deployments, percent
    gain: float | None  # of the mean over deployments, normalised score


def tuned(run: RunData) -> Tuned | None:
    """None before the first evaluation after a deployment."""
    after = [row for row in rows(run) if row.deployment > 0]
    if not after:
        return None
    offline = offline_row(run)
    mean_return = sum(row.returns.mean for row in after) / len(after)
    mean_score = _mean([row.score for row in after])
    return Tuned(
        after[-1],
        mean_return,
        mean_score,
        _mean([row.success for row in after]),
        improvement(mean_return, offline.returns.mean) if offline else None,
        _difference(mean_score, offline.score) if offline else None,
    )


def _mean(values: Sequence[float | None]) -> float | None:
    """None if one is missing."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) else None


def _difference(score: float | None, offline: float | None) -> float | None:
    return None if score is None or offline is None else score - offline


def results(run: RunData) -> dict[str, object]:
    """The contents of results.json."""
    summary = tuned(run)
    return {
        "run": run.record.get("run"),
        "label": QUICK_LABEL if run.quick else None,
        "verdict": asdict(verdict(run)),
        "complete": run.complete,
        "state": run.state,
        "missing": run.problems,
        "name": run.description.name,
        "environment": run.description.env.id,
        "dataset": run.card or {"name": run.description.dataset.name},
        "seed": run.description.seed,
        "description_digest": run.description.digest(),
        "command": run.record.get("command"),
        "versions": run.record.get("versions"),
        "processors": run.record.get("processors"),
        "started": run.record.get("started"),
        "wall_seconds": run.wall_seconds,
        "deployments": run.deployments,
        "measured": [asdict(estimate) for estimate in kept.estimates(run)],
        "recommended": kept.recommended(run),
        "stopped": kept.stopped(run),
        "uniform": asdict(run.uniform) if run.uniform else None,
        "pi_0": run.record.get("origin"),
        "evaluations": [asdict(evaluation) for evaluation in run.evaluations],
        "table": [asdict(row) for row in rows(run)],
        "tuned": asdict(summary) if summary else None,
        "agents": {
            agent.name: {
                "active_dimensions": agent.last("embedding", "active_dimensions"),
                "tunings": [
                    {"deployment": k, **agent.tunings[k].sampler_metrics}
                    for k in sorted(agent.tunings)
                ],
            }
            for agent in run.agents
        },
    }


def to_json(contents: Mapping[str, object]) -> str:
    """Strict JSON: numbers that are not finite become null."""
    return json.dumps(_plain(contents), indent=1, allow_nan=False) + "\n"


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
