"""What a run folder holds so far, read without trust: what is missing or damaged is noted."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TypeVar

from otc_dist.deployment_log.measuring import read_measured
from otc_dist.description import Description
from otc_dist.description.distances import SAMPLER_METRICS
from otc_dist.report import files, uniform
from otc_dist.report.uniform import Uniform
from otc_dist.run import recommendation
from otc_dist.run.folder import RunFolder
from otc_dist.run.measured_returns import Measured, TooFewError
from otc_dist.system import records
from otc_dist.terminal.errors import UserError

T = TypeVar("T")


@dataclass(frozen=True)
class Evaluation:
    """Greedy episodes of the team pi_k, one entry an episode."""

    deployment: int  # k; 0: the offline policies
    returns: list[float]
    lengths: list[int]
    seeds: list[int]
    normalised_score: float | None  # of the mean; None where the task has no reference returns
    policies: dict[str, str]  # agent -> digest of the policy that acted
    successes: list[bool] | None = None  # episodes won; None where the task has no such thing


@dataclass(frozen=True)
class Tuning:
    """What one agent's sampler gave before the updates after one deployment."""

    deployment: int
    sampler_metrics: dict[str, float]  # some of TOLD


@dataclass
class AgentHistory:
    """What one learner reported."""

    name: str
    tunings: dict[int, Tuning] = field(default_factory=dict)  # by deployment
    # phase -> metric -> update -> value; of tuning, updates are counted on over deployments
    curves: dict[str, dict[str, dict[int, float]]] = field(default_factory=dict)

    def last(self, phase: str, metric: str) -> float | None:
        """The newest value of a metric."""
        values = self.curves.get(phase, {}).get(metric)
        return values[max(values)] if values else None


@dataclass(frozen=True)
class RunData:
    """A run as far as it has come."""

    folder: RunFolder
    description: Description
    record: files.Record  # run.json
    card: files.Card | None  # of the data set
    evaluations: list[Evaluation]  # in order of k
    agents: list[AgentHistory]
    deployments: int  # finished ones
    measured: dict[int, Measured]  # by deployment; without those that say nothing
    horizon: int  # h, the steps of an episode that they are measured by; 0 without any
    wall_seconds: float | None
    problems: list[str]  # what is missing or damaged, one line each
    uniform: Uniform | None = None  # the same with uniform sampling, where that was run beside it

    @property
    def quick(self) -> bool:
        return self.record.get("quick") is True

    @property
    def data_return(self) -> float | None:
        """Mean return of the episodes of B_0; None where its card does not say."""
        returns = (self.card or {}).get("returns")
        mean = returns.get("mean") if isinstance(returns, dict) else None
        return float(mean) if isinstance(mean, int | float) and math.isfinite(mean) else None

    @property
    def state(self) -> object:
        """As run.json has it, which calls a run finished when its report is written."""
        state = self.record.get("state")
        return "finished" if state == "reporting" else state

    @property
    def complete(self) -> bool:
        """All deployments took place, or all before the floor, and their evaluations."""
        settings = self.description.deployment
        made = self.deployments if self.ended_by_floor else settings.total
        wanted = set(range(min(made, settings.count) + 1))
        if not self.description.evaluation.episodes:
            wanted = set()
        return self.deployments >= made and wanted <= {e.deployment for e in self.evaluations}

    @property
    def ended_by_floor(self) -> bool:
        """Whether the last deployment was the last since it measured too little."""
        settings = self.description.deployment
        ends = recommendation.ends(settings.floor, self.measured.get(self.deployments))
        return ends and self.deployments < settings.total


def read_run(folder: RunFolder) -> RunData:
    """Read a run folder.

    Raises:
        UserError: it is not a run folder, or its description cannot be read.
    """
    if not folder.description.exists():
        raise folder.lacks(folder.description)
    description = Description.load(folder.description)
    problems: list[str] = []

    record = _attempt(folder.run_json, files.record, problems)
    card = _attempt(folder.dataset_card, files.card, problems)
    evaluations = []
    for k in range(description.deployment.count + 1):
        path = folder.evaluation(k)
        if path.exists():
            evaluation = _attempt(path, read_evaluation, problems)
            if evaluation is not None:
                evaluations.append(evaluation)
    finished = [
        k for k in range(1, description.deployment.total + 1) if folder.deployment(k).exists()
    ]
    measured, horizon = _read_measured(folder, description, finished, problems)
    agents_folder = folder.root / "agents"
    names = sorted(p.name for p in agents_folder.iterdir()) if agents_folder.is_dir() else []
    agents = [
        history
        for name in names
        if (history := _attempt(folder.metrics(name), read_history, problems)) is not None
    ]
    if not agents:
        problems.append("no agent has reported yet")
    return RunData(
        folder=folder,
        description=description,
        record=record or {},
        card=card,
        evaluations=evaluations,
        agents=agents,
        deployments=len(finished),
        measured=measured,
        horizon=horizon,
        wall_seconds=_wall_seconds(folder, record or {}),
        problems=problems,
        uniform=uniform.find(folder, description),
    )


def _read_measured(
    folder: RunFolder, description: Description, finished: list[int], problems: list[str]
) -> tuple[dict[int, Measured], int]:
    found: dict[int, Measured] = {}
    horizon = 0
    if description.deployment.exploration != "none":
        return found, horizon
    for k in finished:
        path = folder.deployment(k)
        try:
            horizon, found[k] = read_measured(path)
        except TooFewError:
            continue
        except UserError as error:
            problems.append(f"{path.name} cannot be read: {error}".replace(str(path), path.name))
        except OSError as error:
            problems.append(f"{path.name} cannot be read: {type(error).__name__}")
    return found, horizon


def _attempt(path: Path, read: Callable[[Path], T], problems: list[str]) -> T | None:
    try:
        return read(path)
    except FileNotFoundError:
        problems.append(f"{path.name} is missing")
    except (UserError, ValueError) as error:
        problems.append(f"{path.name} cannot be read: {error}".replace(str(path), path.name))
    except OSError as error:
        problems.append(f"{path.name} cannot be read: {type(error).__name__}")
    return None


def read_evaluation(path: Path) -> Evaluation:
    """An evaluation. Raises FileNotFoundError, UserError."""
    found = files.evaluated(path)
    return Evaluation(
        deployment=found.evaluation,
        returns=found.returns,
        lengths=found.lengths,
        seeds=found.seeds,
        normalised_score=found.normalised_score,
        policies=dict(found.policies),
        successes=found.successes,
    )


def read_history(path: Path) -> AgentHistory:
    """What the learner reported whose metrics.jsonl this is. Raises OSError, UserError."""
    history = AgentHistory(path.parent.name)
    for line in _lines(path):
        update = line.update
        if line.phase == "tuning":
            # A learner that was restarted repeats itself: the same values at the same places.
            update += (line.deployment - 1) * line.updates
            if line.update == 0:
                sampler_metrics = {
                    name: _number(line.metrics[name])
                    for name in SAMPLER_METRICS
                    if name in line.metrics
                }
                history.tunings[line.deployment] = Tuning(line.deployment, sampler_metrics)
        curves = history.curves.setdefault(line.phase, {})
        for name, value in line.metrics.items():
            curves.setdefault(name, {})[update] = _number(value)
    return history


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _lines(path: Path) -> Iterator[files.Line]:
    """The lines of metrics.jsonl; a last one that was cut off is left out.

    So is the beginning of one that another was written after, as earlier versions did.
    """
    lines = path.read_text(encoding="utf-8").splitlines()
    for i, text in enumerate(lines):
        whole = max(text.rfind('{"phase"'), 0)
        try:
            yield records.from_json(files.Line, text[whole:], path)
        except UserError:
            if i != len(lines) - 1:
                raise


def _wall_seconds(folder: RunFolder, record: files.Record) -> float | None:
    """From the start to the end, or to the newest result where no end is noted."""
    try:
        started = datetime.fromisoformat(str(record["started"])).timestamp()
        if record.get("finished"):
            return datetime.fromisoformat(str(record["finished"])).timestamp() - started
    except (KeyError, ValueError):
        return None
    results = [*folder.root.glob("evaluations/*.json"), *folder.root.glob("agents/*/metrics.jsonl")]
    return max(p.stat().st_mtime for p in results) - started if results else None
