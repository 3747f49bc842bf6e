"""A short form of `launch chaos`: faults of several kinds strike one run, which ends the same."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.launch.__main__ import main
from otc_dist.launch.chaos.disturbed_run import PHASES, DisturbedRun, StuckError
from otc_dist.launch.chaos.outcome import differences, outcome
from otc_dist.report.write import write_report
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError
from tests.report.conftest import MadeRun


@pytest.mark.parametrize(
    ("faults", "says"),
    [
        (["kill-hots=1"], "did you mean 'kill-host'?"),
        (["freeze=1", "freeze=2"], "freeze is given twice: how often?"),
        *(([f"freeze{count}"], "write it as freeze=20") for count in ("", "=", "=0", "=-1", "=²")),
    ],
)
def test_a_mistake_is_one_line(faults: list[str], says: str) -> None:
    with pytest.raises(UserError) as caught:
        main(["chaos", *faults])
    assert says in str(caught.value)


def test_a_folder_that_cannot_be_made_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "otc_dist.launch.chaos.sandbox.enter", lambda: None
    )  # it would leave pytest
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"cannot make .*/file/out"):
        main(["chaos", "--out", str(tmp_path / "file" / "out")])
    with pytest.raises(UserError, match="is not empty: use another --out"):
        main(["chaos", "--out", str(tmp_path)])


def test_a_launcher_that_ends_by_itself_has_failed(tmp_path: Path) -> None:
    with DisturbedRun(tmp_path / "run", ("3agent_hoper",)) as run:
        run.start()
        with pytest.raises(StuckError, match="ended by itself, 2: error: unknown description"):
            run.finish()


class _QuickRun(DisturbedRun):
    """A run that is over before anything can strike it."""

    def start(self) -> None:
        self.folder.root.mkdir(parents=True)

    @property
    def over(self) -> bool:
        return True


def test_a_fault_that_was_asked_for_and_never_struck_has_not_passed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("otc_dist.launch.chaos.sandbox.enter", lambda: None)
    monkeypatch.setattr("otc_dist.launch.chaos.command.DisturbedRun", _QuickRun)
    monkeypatch.setattr("otc_dist.launch.chaos.command.outcome", lambda folder: {})
    assert main(["chaos", "kill-compiler=2", "--out", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert "kill-compiler: nothing to strike in 3 runs" in said.err
    assert said.out.splitlines()[-1].split()[:6] == ["kill-compiler", "0", "of", "2", "3", "3"]


def _named(folder: RunFolder, run: str, moment: str) -> RunFolder:
    """Another run of the same description, which ended the same."""
    record = json.loads(folder.run_json.read_text())
    record |= {"run": run, "started": f"2026-{moment}", "finished": f"2027-{moment}"}
    folder.run_json.write_text(json.dumps(record))
    write_report(folder)
    return folder


@pytest.fixture
def two(tmp_path: Path) -> tuple[RunFolder, RunFolder]:
    """Two runs that have left the same, but for their names and times."""
    first = MadeRun(tmp_path / "first").folder
    shutil.copytree(first.root, tmp_path / "second")
    second = RunFolder(tmp_path / "second")
    with second.metrics("agent_0").open("a") as file:  # as a learner that was started again
        file.write(first.metrics("agent_0").read_text().splitlines()[-1] + "\n")
    moments = ("01-01T10:00:00+00:00", "02-02T11:00:00+00:00")
    return _named(first, "one", moments[0]), _named(second, "other", moments[1])


def test_what_two_runs_of_one_description_leave_is_the_same(
    two: tuple[RunFolder, RunFolder],
) -> None:
    assert differences(outcome(two[0]), outcome(two[1])) == []


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("deployments/deployment_01.mcap.new", lambda text: "left behind"),
        ("supervision.json", lambda text: "{}"),
        ("agents/agent_1/metrics.jsonl", lambda text: text.replace("0.5", "0.25")),
        ("evaluations/evaluation_02.json", lambda text: text.replace("20.0", "21.0")),
        ("run.json", lambda text: text.replace("2.7.0", "2.7.1")),
        ("dataset_card.json", lambda text: text.replace("abab", "acac")),
    ],
)
def test_a_run_that_left_something_else_is_told(
    two: tuple[RunFolder, RunFolder], name: str, change: Callable[[str], str]
) -> None:
    path = two[1].root / name
    path.write_text(change(path.read_text() if path.exists() else ""))
    write_report(two[1])
    assert name in differences(outcome(two[0]), outcome(two[1]))


@pytest.mark.parametrize("name", ["results.json", "report.html"])
def test_a_report_that_is_not_the_run_s_is_told(
    two: tuple[RunFolder, RunFolder], name: str
) -> None:
    (two[1].root / name).write_bytes((two[0].root / name).read_bytes())
    with pytest.raises(ValueError, match=f"{name} is not that of what the run has left"):
        outcome(two[1])


@pytest.mark.slow
def test_whatever_strikes_the_run_ends_with_the_same_bytes(tmp_path: Path) -> None:
    """Its kinds that need namespaces, or a tool that is missing, are told as skipped."""
    faults = ("kill-router=1", "fill-disk=1", "any=1")
    done = subprocess.run(
        [sys.executable, "-m", "otc_dist.launch", "chaos", *faults, "--out", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for fault, line in zip(faults, done.stdout.splitlines()[-len(faults) :], strict=True):
        name, count = fault.split("=")
        assert line.split()[0] == name
        struck, runs, identical, *_ = line.split()[1:]
        if struck != "skipped:":
            assert (struck, runs) == (count, identical)
    assert not (tmp_path / "wrong").exists()


def test_a_launcher_that_starts_may_yet_prepare_anything(tmp_path: Path) -> None:
    """So what strikes the compiler alone waits for it, though the run's first phase is `start`."""
    with DisturbedRun(tmp_path / "run", ("navigation", "--dry-run")) as run:
        run.start()
        assert run.phases_ahead == PHASES
