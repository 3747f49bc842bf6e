"""Raw scores: one JSON file a run (seed, arm), and where everything of a comparison lies."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any, Self

from otc_dist import durable
from otc_dist.errors import UserError
from otc_dist.run_folder import RunFolder

FORMAT = 1


@dataclass(frozen=True)
class Evaluation:
    """Greedy episodes of a team pi_k."""

    returns: list[float]  # team return of each episode
    lengths: list[int]  # steps of each episode
    policies: dict[str, str]  # agent -> digest of its policy
    successes: list[bool] | None = None  # episodes won; None where the task has no such thing

    @property
    def success(self) -> float | None:
        """Percent of the episodes won."""
        return 100 * sum(self.successes) / len(self.successes) if self.successes else None


@dataclass(frozen=True)
class Run:
    """All that one run of an arm showed. `evaluations` are of pi_0 .. pi_K, in order."""

    arm: str
    seed: int
    description: str  # digest of the run's description
    evaluations: list[Evaluation]
    # of each deployment 1..K, agent -> what Eq. 4 gave; empty where the arm has no alpha
    alpha: list[dict[str, float]] = field(default_factory=list)
    similarity: list[dict[str, float]] = field(default_factory=list)
    assignments: list[str] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0  # that the run took: the one field that differs when it is repeated
    format: int = FORMAT

    def write(self, path: Path) -> None:
        """Atomically. Raises UserError if it cannot be written."""
        write_json(path, asdict(self))

    @classmethod
    def read(cls, path: Path) -> Self:
        """Raises UserError if it is missing or damaged."""
        fields = read_json(path)
        try:
            evaluations = [Evaluation(**item) for item in fields.pop("evaluations")]
            run = cls(**fields, evaluations=evaluations)
        except (KeyError, TypeError) as error:
            raise UserError(f"{path} is damaged ({error}); delete it") from None
        if run.format != FORMAT:
            raise UserError(f"{path} has format {run.format}; this version reads {FORMAT}")
        return run


@dataclass(frozen=True)
class ComparisonFolder:
    """Paths of a comparison's files.

    description.toml          the resolved description that all arms share
    seeds/seed_00/agents/     offline checkpoints of a seed, one folder an agent
    seeds/seed_00/pi_0.json   greedy returns of its offline policies, shared by all arms
    seeds/seed_00/ARM.json    raw scores of one run
    mechanism/NAME/seed_00.json   what samplers select, by the analysis of that name
    output/                   what each process printed
    comparison.json, comparison.html
    """

    root: Path

    @property
    def description(self) -> Path:
        return self.root / "description.toml"

    @property
    def results(self) -> Path:
        return self.root / "comparison.json"

    @property
    def report(self) -> Path:
        return self.root / "comparison.html"

    def seed(self, seed: int) -> RunFolder:
        return RunFolder(self.root / "seeds" / f"seed_{seed:02d}")

    def offline(self, seed: int) -> Path:
        return self.seed(seed).root / "pi_0.json"

    def run(self, seed: int, arm: str) -> Path:
        return self.seed(seed).root / f"{arm}.json"

    def mechanism(self, name: str, seed: int) -> Path:
        return self.root / "mechanism" / name / f"seed_{seed:02d}.json"

    def output(self, seed: int, job: str) -> Path:
        return self.root / "output" / f"seed_{seed:02d}_{job}.log"

    def finished(self, seed: int, arm: str, digest: str) -> Run | None:
        """The run if it is done. Raises UserError if it is of another description than `digest`."""
        path = self.run(seed, arm)
        if not path.exists():
            return None
        run = Run.read(path)
        if run.description != digest:
            raise UserError(f"{path} is of another description; delete it, or use another --out")
        return run


def write_json(path: Path, fields: Mapping[str, Any]) -> None:
    """Replace `path` in one step; null stands for NaN. Raises UserError if it cannot be written."""
    try:
        durable.write(path, (json.dumps(_without_nan(fields), indent=1) + "\n").encode())
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from None


def _without_nan(value: object) -> object:
    """JSON knows no NaN: None stands for it."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def read_json(path: Path) -> dict[str, Any]:
    """Raises UserError if `path` is missing or holds no JSON object."""
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UserError(f"cannot read {path}: {error}; delete it") from None
    if not isinstance(fields, dict):
        raise UserError(f"{path} is damaged; delete it")
    return fields
