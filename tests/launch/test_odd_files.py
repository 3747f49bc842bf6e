"""Every file of a run that is read back: whatever stands in it, it is that or one line."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save

from otc_dist.comparison.scores import Evaluation
from otc_dist.comparison.scores import Run as Scores
from otc_dist.datasets.card import AgentFile, DatasetCard, Summary
from otc_dist.launch.__main__ import main
from otc_dist.launch.plan import descriptions
from otc_dist.launch.plan.placement import Placement
from otc_dist.launch.plan.run_record import RunRecord
from otc_dist.launch.show.approve import waiting_lines
from otc_dist.launch.show.process_states import ProcessState, Supervision
from otc_dist.learner import checkpoint
from otc_dist.learner.checkpoint import CheckpointMetadata
from otc_dist.report.write import write_report
from otc_dist.run.folder import RunFolder
from otc_dist.run.host_state import HostState
from otc_dist.run.measured_returns import Measured
from otc_dist.terminal.errors import UserError
from tests.odd_json import twisted

RECORD = RunRecord(
    "run", "0" * 16, ["python"], {"numpy": "2"}, "2026-01-01T10:00:00+00:00", "finished",
    place=Placement("host", listen="tls/0.0.0.0:1"), resumed=("2026-01-01T10:00:00+00:00",),
    extended=(3,), inputs={"a": "b"},
)  # fmt: skip
PROCESS = ProcessState("works", 1.0, 7, 0, "", "offline", 0, 3, 5, 1.0, {"return": 2.0})
SUPERVISION = Supervision(1, "2026-01-01T10:00:00+00:00", None, {"host": PROCESS})
WAITING = {
    "waits_for": "a person", "deployment": 2, "policy": 1, "approve_by": "deployments/approved_02",
    "measured": {"deployment": 1, "mean": 1.0, "error": 0.1, "episodes": 3}, "greedy_return": 2.0,
}  # fmt: skip
EVALUATION = {
    "evaluation": 0, "policies": {"agent_0": "0" * 16}, "returns": [1.0, 2.0], "lengths": [3, 4],
    "seeds": [1, 2], "mean_return": 1.5, "normalised_score": 0.1, "successes": [True, False],
}  # fmt: skip
LINE = {"phase": "tuning", "deployment": 1, "update": 0, "updates": 4, "metrics": {"alpha": 1.0}}
SCORES = Scores(
    "uniform", 0, "0" * 16, [Evaluation([1.0], [2], {"agent_0": "0" * 16})] * 2,
    told=[{"agent_0": {"alpha": 1.0}}], measured=[Measured(1.0, 0.1, 3)], best=1,
)  # fmt: skip
CARD = DatasetCard(
    name="hopper-3x1/random", env_id="hopper-3x1", transitions=8, terminated=1, truncated=0,
    episodes=1, incomplete_episodes=0, origin="made", recipe={"a": "b"}, notes=("n",),
    returns=Summary(mean=1, std=1, minimum=1, maximum=1), normalised_score=None, versions={},
    files={"agent_0": AgentFile(bytes=1, sha256="", observation_size=1, action_size=1)},
)  # fmt: skip
HOST, FIRST = HostState(1, 2, {"a": "b"}), "evaluations/evaluation_00.json"
PROGRESSED = CheckpointMetadata("agent_0", "0" * 16, "0" * 16, 3, 0, 1.0, 0.5)


@dataclass
class Case:
    """A file by its path in the run folder, what is in it, and who reads it."""

    file: str
    content: bytes
    read: Callable[[RunFolder], object]
    tells: bool = False  # a report: what is wrong stands in it, and the rest as well


def _json(value: object) -> bytes:
    return json.dumps(value).encode()


def _report(folder: RunFolder) -> object:
    for name, content in (("run.json", _json(asdict(RECORD))), ("description.toml", b"")):
        path = folder.root / name
        if not path.exists():
            path.write_bytes(content or descriptions.find("navigation").read_bytes())
    return write_report(folder)


CASES = {
    "run.json": Case("run.json", _json(asdict(RECORD)), RunRecord.read),
    "supervision": Case("supervision.json", _json(asdict(SUPERVISION)), Supervision.read),
    "waiting": Case("waiting.json", _json(WAITING), waiting_lines),
    "host": Case("deployments/host.json", _json(asdict(HOST)), HostState.begin),
    "scores": Case("a.json", _json(asdict(SCORES)), lambda f: Scores.read(f.root / "a.json")),
    "card": Case("card.json", CARD.to_json().encode(), lambda f: DatasetCard.read(f.root)),
    "report of run.json": Case("run.json", _json(asdict(RECORD)), _report, tells=True),
    "report of card": Case("dataset_card.json", CARD.to_json().encode(), _report, tells=True),
    "report of evaluation": Case(FIRST, _json(EVALUATION), _report, tells=True),
    "report of metrics": Case("agents/agent_0/metrics.jsonl", _json(LINE), _report, tells=True),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_whatever_stands_in_a_file_it_is_right_or_one_line_says_what_is_not(
    name: str, tmp_path: Path
) -> None:
    case, folder = CASES[name], RunFolder(tmp_path)
    path = tmp_path / case.file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(case.content)
    case.read(folder)
    refused = 0
    for content in list(twisted(case.content))[:: 7 if case.tells else 3]:
        path.write_bytes(content)
        try:
            case.read(folder)
        except UserError as error:
            refused += 1
            assert path.name in str(error) and str(error).isprintable() and len(str(error)) < 600
    assert case.tells or refused or name == "card"


def test_a_checkpoint_whose_header_is_sealed_anew(tmp_path: Path) -> None:
    path, arrays = tmp_path / "checkpoint_00.safetensors", {"a.b": np.zeros(2, np.float32)}
    refused = 0
    for content in twisted(_json({"format": checkpoint.FORMAT, **asdict(PROGRESSED)})):
        try:
            about = json.loads(content)
            about["digest"] = checkpoint._seal(arrays, about)
            text = json.dumps(about)
        except (ValueError, TypeError, RecursionError):
            text = content.decode(errors="replace")
        path.write_bytes(save(arrays, metadata={"otc_dist": text}))
        try:
            checkpoint.read(path)
        except UserError as error:
            refused += 1
            assert path.name in str(error) and str(error).isprintable()
    assert refused > 50


def test_an_approval_is_written_where_it_belongs(tmp_path: Path) -> None:
    root = tmp_path / "run"
    (root / "deployments").mkdir(parents=True)
    RECORD.write(RunFolder(root))
    (root / "waiting.json").write_bytes(_json({**WAITING, "approve_by": "../../outside"}))
    main(["approve", str(root)])
    assert (root / "deployments/approved_02").exists() and not (tmp_path / "outside").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
