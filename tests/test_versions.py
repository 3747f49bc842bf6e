"""docs/versions.md says what the code does: its numbers, and the lines by which it refuses."""

import re
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from otc_dist.bus import wire
from otc_dist.comparison.scores import Run
from otc_dist.datasets import agent_files
from otc_dist.deployment_log import format as log_format
from otc_dist.deployment_log.header import LogHeader
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.launch.plan import run_record
from otc_dist.launch.plan.placement import Placement
from otc_dist.learner import checkpoint
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "versions.md").read_text()
ROWS = re.findall(r"^\| .+? \| `([\w.]+)` \| ([\w.]+) \| (\d*) ?\|$", PAGE, re.M)


def quoted(start: str) -> str:
    """The one line of the page that begins so."""
    (line,) = re.findall(rf"^```text\n({re.escape(start)}.*)\n```$", PAGE, re.M)
    return str(line)


@pytest.mark.parametrize(("constant", "now", "still"), ROWS)
def test_the_table_holds_the_codes_numbers(constant: str, now: str, still: str) -> None:
    module, _, name = constant.rpartition(".")
    assert str(getattr(import_module(module), name)) == now
    if still:
        assert module == log_format.__name__
        assert int(still) == log_format.MINIMUM_FORMAT_VERSION


def test_every_version_of_a_format_is_in_the_table() -> None:
    older = {f"{name}_VERSION" for name in ("MINIMUM_FORMAT", "FIRST_BOUND", "UNTIMED")}
    older.add("FIRST_TIMED_VERSION")  # all of the log, up to its own
    found = set()
    for path in (ROOT / "otc_dist").rglob("*.py"):
        for name in re.findall(r"^(\w*(?:VERSION|FORMAT)) = \d", path.read_text(), re.M):
            if name not in older:
                found.add(".".join(path.relative_to(ROOT).with_suffix("").parts) + f".{name}")
    assert found == {constant for constant, *_ in ROWS} - {"otc_dist.__version__"}


def _run(folder: Path) -> None:
    record = run_record.RunRecord("run", "digest", [], {"torch": "0.0"}, "now", place=Placement())
    run_record.check_versions(record, RunFolder(folder))


def _log(path: Path) -> None:
    header = LogHeader("run", 1, 0, "", "", registry.team_spec("hopper-3x1"), 1)
    LogHeader.from_entries(replace(header, format_version=4).to_entries(), path)


def _checkpoint(path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checkpoint, "FORMAT", 2)
        progressed = checkpoint.CheckpointMetadata("agent_0", "", "", 0, 0, 1.0, 1.0)
        checkpoint.write(path, {"x": np.zeros(1)}, progressed)
    checkpoint.read(path)


def _data(path: Path) -> None:
    header = agent_files.Header(
        format_version=2,
        dataset="hopper-3x1/medium",
        env_id="hopper-3x1",
        agent="agent_0",
        transitions=0,
        observation_size=11,
        action_size=1,
        origin="",
        versions={},
    )
    save_file({"x": np.zeros(1)}, path, {"otc_dist": header.model_dump_json()})
    agent_files.load_agent(path, "agent_0")


def _scores(path: Path) -> None:
    path.write_text('{"format": 1}')
    Run.read(path)


def _description(path: Path) -> None:
    task = {"name": "a", "env": {"id": "hopper-3x1"}, "dataset": {"name": "medium"}}
    Description.build(task, ["sampling.distanc=value"])


def _messages(path: Path) -> None:
    raise UserError(wire.version_mismatch(5))  # as every receiver does


REFUSED = {
    "RUN was begun": _run,
    "LOG is of": _log,
    "the other process speaks": _messages,
    "the checkpoint PATH": _checkpoint,
    "PATH has format version": _data,
    "PATH has format 1": _scores,
    "command line: unknown key": _description,
}


@pytest.mark.parametrize(("start", "refuse"), REFUSED.items(), ids=REFUSED)
def test_what_is_refused_says_the_line_of_the_page(
    start: str, refuse: Callable[[Path], None], tmp_path: Path
) -> None:
    path = tmp_path / "it"
    with pytest.raises(UserError) as caught:
        refuse(path)
    now = run_record.versions()["torch"]
    line = quoted(start).replace("NOW", now)
    assert str(caught.value) == re.sub(r"\b(PATH|LOG|RUN)\b", str(path), line)
