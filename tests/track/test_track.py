"""A run written to trackers, and read back by their own readers: all of it, each point once."""

import fcntl
import json
import shlex
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.run.folder import RunFolder
from otc_dist.system import extras
from otc_dist.terminal.errors import UserError, os_error_line
from otc_dist.track import trackers, write
from otc_dist.track.__main__ import main
from otc_dist.track.points import Points
from tests.report.conftest import MadeRun

from .readers import READERS, measured


@pytest.fixture
def made(tmp_path: Path) -> MadeRun:
    return MadeRun(tmp_path / "run")


@pytest.mark.parametrize("tracker", sorted(trackers.TRACKERS))
def test_every_point_is_there_once_however_often_it_is_written(made: MadeRun, tracker: str) -> None:
    out, read = made.folder.tracking(tracker), READERS[tracker]
    out.mkdir(parents=True)
    cut_off = trackers.open_tracker(tracker, out, write._about(made.folder))
    for each in list(Points(made.folder).new())[:5]:
        cut_off.log(each.source, each.step, each.values)
    cut_off.flush()  # and never closed

    command = [str(made.folder.root), "--to", tracker]
    assert main(command) == 0
    points, settings = read(out)
    assert points == measured(made.folder)
    assert ("team/return/greedy", 2, 10.0) in points  # of pi_2
    assert ("team/return/measured", 2, 6.0) in points  # by deployment 2
    assert ("agent_1/offline/loss", 200, 1.0) in points
    assert ("agent_0/tuning/alpha", 100, 0.5) in points  # deployments count on
    assert settings["deployment.keep"] == "best" and settings["seed"].startswith("5")

    made.report("agent_1", "tuning", 3, 50, 100, loss=7.0)
    assert main(command) == 0
    more, _ = read(out)
    assert set(more) - set(points) == {("agent_1/tuning/loss", 250, 7.0)}
    assert len(more) == len(points) + 1


def test_a_run_that_is_extended_is_one_run_of_mlflow_s_with_its_new_settings(
    made: MadeRun,
) -> None:
    command = [str(made.folder.root), "--to", "mlflow"]
    assert main(command) == 0
    made.describe("deployment.count=7")
    assert main(command) == 0
    points, settings = READERS["mlflow"](made.folder.tracking("mlflow"))
    assert points == measured(made.folder) and settings["deployment.count"] == "7"


class _Meanwhile(threading.Event):
    """What happens between the tracker's first look and its second."""

    def __init__(self, happens: Callable[[threading.Event], object]) -> None:
        super().__init__()
        self._happens = happens

    def wait(self, timeout: float | None = None) -> bool:
        self._happens(self)
        return True


@pytest.mark.parametrize("way", ["finished", "asked to end"])
def test_a_run_is_followed_to_its_last_point(made: MadeRun, way: str) -> None:
    def happens(ended: threading.Event) -> None:
        made.report("agent_0", "tuning", 3, 50, 100, loss=7.0)
        with made.folder.metrics("agent_0").open("a") as file:
            file.write('{"phase": "tun')  # a line that is being written
        if way == "finished":
            made.write_record(state="finished")
        else:
            ended.set()

    made.write_record(state="running")
    out = made.folder.tracking("tensorboard")
    assert write.write(made.folder, "tensorboard", out, _Meanwhile(happens)) == []
    points, _ = READERS["tensorboard"](out)
    assert points == measured(made.folder)
    assert ("agent_0/tuning/loss", 250, 7.0) in points


def test_a_run_that_has_begun_only_is_followed_from_its_first_point(
    made: MadeRun, tmp_path: Path
) -> None:
    young = RunFolder(tmp_path / "young")
    young.root.mkdir()
    young.description.write_bytes(made.folder.description.read_bytes())
    record = json.loads(made.folder.run_json.read_text())
    young.run_json.write_text(json.dumps({**record, "state": "running"}))

    def happens(ended: threading.Event) -> None:
        made.folder.root.joinpath("agents").rename(young.root / "agents")
        ended.set()

    out = tmp_path / "elsewhere"
    assert write.write(young, "tensorboard", out, _Meanwhile(happens)) == []
    assert READERS["tensorboard"](out)[0] == measured(young) != []


def test_what_is_damaged_is_left_out_and_said(
    made: MadeRun, capsys: pytest.CaptureFixture[str]
) -> None:
    before = measured(made.folder)
    made.folder.evaluation(1).write_text("{}")
    assert main([str(made.folder.root), "--to", "tensorboard"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("left out: ") and "evaluation_01.json is damaged" in line
    points, _ = READERS["tensorboard"](made.folder.tracking("tensorboard"))
    assert {(name, step) for name, step, _ in set(before) - set(points)} == {
        ("team/return/greedy", 1),
        ("team/return/normalised_score", 1),
    }


@pytest.mark.parametrize("tracker", sorted(trackers.TRACKERS))
def test_what_cannot_be_written_is_one_line(
    made: MadeRun, tmp_path: Path, tracker: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def said(*arguments: object) -> str:
        with pytest.raises((UserError, OSError)) as refused:
            main([*map(str, arguments), "--to", tracker])
        error = refused.value
        line = os_error_line(error) if isinstance(error, OSError) else str(error)
        assert "\n" not in line
        return line

    run, out = made.folder.root, tmp_path / "out"
    assert said(tmp_path) == f"{tmp_path} is not a run folder: it has no run.json"
    out.write_text("a file")
    assert said(run, "--out", out) == f"{out}: File exists"
    assert said(run, "--out", out / "below") == f"{out / 'below'}: Not a directory"
    out.unlink()
    out.mkdir()
    with (out / write._LOCK).open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert "another process is writing" in said(run, "--out", out)
    for name in ("team", "mlflow.db"):
        (out / name).write_text("what another one left there")
    assert str(out) in said(run, "--out", out)

    monkeypatch.setattr(extras, "find_spec", lambda package: None)
    line = said(run)
    assert line.startswith(f"tracking by {tracker} needs the package ")
    words = shlex.split(line.partition(": ")[2])
    assert words[1:4] == ["-m", "pip", "install"] and len(words) > 4


@pytest.mark.parametrize("tracker", sorted(trackers.TRACKERS))
@pytest.mark.parametrize("below", ["", "agents", "deployments/tensorboard"])
def test_nothing_is_written_among_a_run_s_files(made: MadeRun, tracker: str, below: str) -> None:
    run = made.folder.root
    before = sorted(run.rglob("*"))
    with pytest.raises(UserError, match=f"its own place is {made.folder.tracking(tracker)}$"):
        main([str(run), "--to", tracker, "--out", str(run / below)])
    assert sorted(run.rglob("*")) == before


def test_a_tensorboard_of_another_run_stays(made: MadeRun, tmp_path: Path) -> None:
    out = tmp_path / "tensorboard"
    written = [str(made.folder.root), "--to", "tensorboard", "--out", str(out)]
    assert main(written) == 0
    points = READERS["tensorboard"](out)
    other = MadeRun(tmp_path / "other")
    other.write_record(run="another")
    with pytest.raises(UserError, match="holds another run, which would be lost"):
        main([str(other.folder.root), *written[1:]])
    assert READERS["tensorboard"](out) == points
    assert main(written) == 0


_NO_SPACE = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
from otc_dist.terminal.errors import run_main
from otc_dist.track.__main__ import main
run_main(main)
"""


def test_a_disk_that_takes_no_more_is_one_line(made: MadeRun) -> None:
    """The writer of TensorBoard's files has a thread, which says nothing of its own."""
    command = [sys.executable, "-c", _NO_SPACE, str(made.folder.root), "--to", "tensorboard"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    out = made.folder.tracking("tensorboard")
    assert (done.returncode, done.stderr) == (2, f"error: cannot write {out}: File too large\n")


def test_nobody_else_s_event_files_are_touched(made: MadeRun) -> None:
    out = made.folder.tracking("tensorboard")
    (out / "team").mkdir(parents=True)
    theirs = out / "team" / "events.out.tfevents.1.host.1.0"
    theirs.write_bytes(b"")
    for _ in range(2):
        assert main([str(made.folder.root), "--to", "tensorboard"]) == 0
    assert theirs.exists() and len(list(theirs.parent.iterdir())) == 2
