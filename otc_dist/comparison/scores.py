"""Raw scores: one JSON file a run (seed, arm), and where everything of a comparison lies."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from math import isfinite
from pathlib import Path
from typing import Any, Self

from pydantic import ConfigDict

from otc_dist.run.folder import RunFolder
from otc_dist.run.measured_returns import Measured, best
from otc_dist.system import durable, records
from otc_dist.terminal.errors import UserError

FORMAT = 2
LATER = {"together"}  # what earlier files of this format lack
OFFLINE = "pi_0.json"  # greedy returns of a seed's offline policies
SPENT = "spent.json"  # what the jobs of a seed took, where raw scores are kept
NO_RUNS = (OFFLINE, SPENT)  # the files of a seed's folder that are no run's

SamplerMetrics = dict[str, float | None]  # name -> value; None where it is not a number


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
    """All that one run of an arm showed. `evaluations` are of pi_0 .. pi_K, in order.

    Attributes:
        together: the seeds with which the offline updates of its pi_0 were made at once, which
            rounds otherwise than alone; empty: alone.
        told: of each deployment 1..K, agent -> what its sampler gave before the updates after it,
            like Eq. 4's alpha and similarity; empty where it gives nothing.
        measured: what each deployment 1..K said of the policies pi_{k-1} that acted in it, over the
            first `horizon` steps of its episodes; None where too few episodes had room for them.
        best: the deployment with the greatest estimate, from 1; None if one could not be measured.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    arm: str
    seed: int
    description: str  # digest of the run's description
    evaluations: list[Evaluation]
    offline: str = ""  # digest of what its pi_0 depends on
    together: list[int] = field(default_factory=list)
    analysis: str = ""  # what an arm looks at that no learner may see; empty of any other
    told: list[dict[str, SamplerMetrics]] = field(default_factory=list)
    measured: list[Measured | None] = field(default_factory=list)
    horizon: int = 0
    best: int | None = None
    assignments: list[str] = field(default_factory=list)
    processor: str = ""  # results of another one differ in bits
    versions: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0  # that the run took: the one field that differs when it is repeated
    format: int = FORMAT

    def write(self, path: Path) -> None:
        """Atomically. Raises UserError if it cannot be written."""
        write_json(path, asdict(self))

    @classmethod
    def read(cls, path: Path) -> Self:
        """Raises UserError if it is missing or damaged."""
        found = read_json(path)
        if found.get("format") != FORMAT:
            version = found.get("format", "unknown")
            raise UserError(
                f"{path} has format {version!r:.60}; this version reads {FORMAT}: delete it"
            )
        try:
            there = LATER | found.keys()
            if missing := [one.name for one in fields(cls) if one.name not in there]:
                raise UserError(f"{path} is damaged: it has no {missing[0]}")
            run = records.read_json(cls, path)
            run._check()
        except UserError as error:
            raise UserError(f"{error}; delete it") from None
        except ValueError as error:
            raise UserError(f"{path} is damaged ({error}); delete it") from None
        return run

    def _check(self) -> None:
        """Raises ValueError or TypeError if it cannot be what a run has shown."""
        for evaluation in self.evaluations:
            if not evaluation.returns or not all(map(isfinite, evaluation.returns)):
                raise ValueError("an evaluation without finite returns")
        if len(self.measured) != len(self.evaluations) - 1:
            raise ValueError(f"{len(self.measured)} deployments measured")
        if self.best != best_of(self.measured):
            raise ValueError(f"deployment {self.best} is not the best")


def best_of(measured: Sequence[Measured | None]) -> int | None:
    """The deployment with the greatest estimate, from 1; None if one could not be measured."""
    known = [one for one in measured if one is not None]
    return best(known) if known and len(known) == len(measured) else None


@dataclass(frozen=True)
class ComparisonFolder:
    """Paths of a comparison's files.

    description.toml          the resolved description that all arms share
    quick                     there if it was begun as a quick look, which it stays
    inputs.json               digests of the data, and of a user's own sources, that all arms share
    seeds/seed_00/agents/     offline checkpoints of a seed, one folder an agent
    seeds/seed_00/pi_0.json   greedy returns of its offline policies, shared by all arms
    seeds/seed_00/own/DIGEST/ the same of arms that train another pi_0, by its digest
    seeds/seed_00/ARM.json    raw scores of one run
    mechanism/NAME/seed_00.json   what samplers select, by the analysis of that name
    output/                   what each process printed, and beside it the time that it took
    comparison.json, comparison.html
    """

    root: Path

    @property
    def description(self) -> Path:
        return self.root / "description.toml"

    @property
    def quick(self) -> Path:
        return self.root / "quick"

    @property
    def inputs(self) -> Path:
        return self.root / "inputs.json"

    @property
    def results(self) -> Path:
        return self.root / "comparison.json"

    @property
    def report(self) -> Path:
        return self.root / "comparison.html"

    def seed(self, seed: int) -> RunFolder:
        return RunFolder(self.root / "seeds" / f"seed_{seed:02d}")

    def own(self, seed: int, digest: str) -> RunFolder:
        """The same for arms whose pi_0 has another offline digest than the one that is shared."""
        return RunFolder(self.seed(seed).root / "own" / digest)

    def offline(self, seed: int) -> Path:
        return self.seed(seed).root / OFFLINE

    def run(self, seed: int, arm: str) -> Path:
        return self.seed(seed).root / f"{arm}.json"

    def mechanism(self, name: str, seed: int) -> Path:
        return self.root / "mechanism" / name / f"seed_{seed:02d}.json"

    def output(self, seed: int, job: str) -> Path:
        return self.root / "output" / f"seed_{seed:02d}_{job}.log"

    @staticmethod
    def job(output: Path) -> str:
        """The job that prints to `output`, whatever its seed."""
        return re.sub(r"^seed_\d+_", "", output.stem)

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
    durable.put(path, to_json(fields))


def to_json(fields: Mapping[str, Any]) -> bytes:
    """A file's content; null stands for NaN."""
    return (json.dumps(_without_nan(fields), indent=1) + "\n").encode()


def compact(path: Path) -> bytes:
    """The content of a file that `write_json` made, in two thirds of its bytes: a field a line.

    Raises:
        UserError: as `read_json`.
    """
    lines = (
        f'"{key}":{json.dumps(item, separators=(",", ":"))}'
        for key, item in read_json(path).items()
    )
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


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
        fields = records.read_json(dict[str, Any], path)
    except (FileNotFoundError, UserError) as error:
        raise UserError(f"cannot read {path}: {error}; delete it") from None
    return fields
