"""What a run does before and after its processes: supervised like these, with real commands."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from otc_dist.launch.run import one_off
from otc_dist.launch.run.one_off import StoppedError, run_one_off
from otc_dist.launch.supervise import standstill
from otc_dist.launch.supervise.health import LIMIT
from otc_dist.launch.supervise.processes import DiedError
from otc_dist.launch.supervise.signals import Signals
from otc_dist.launch.supervise.supervisor import Supervisor

PATIENCE = 30.0  # seconds; only a test that fails waits as long
# Does something odd as often as it is told, by a file in which it counts, and then ends well.
ODD = """
import os, signal, sys, threading, time
path, often, what = sys.argv[1:]
with open(path, "a+") as file:
    file.write("x"); file.seek(0); count = len(file.read())
if count <= int(often):
    {
        "dies": lambda: os.kill(os.getpid(), signal.SIGKILL),
        "is stopped": lambda: os.kill(os.getpid(), signal.SIGSTOP),
        "hangs": lambda: threading.Event().wait(),
        "its child hangs": lambda: os.system("sleep 1000"),
        "fails": lambda: sys.exit(1),
        "refuses": lambda: sys.exit(2),
    }[what]()
"""


@pytest.fixture
def do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., int]]:
    """Run the command above, and how often it was started."""
    monkeypatch.setattr(one_off, "FIRST_DELAY", 0.001)
    monkeypatch.setattr(one_off, "_LOOK", 0.05)
    with Signals() as signals, Supervisor(signals) as supervisor:

        def run(often: int, what: str, patience: float = PATIENCE) -> int:
            command = (sys.executable, "-c", ODD, str(tmp_path / "count"), str(often), what)
            run_one_off({"data": command}, tmp_path.joinpath, supervisor, signals, patience)
            assert supervisor.running == ()
            return len((tmp_path / "count").read_text())

        yield run


@pytest.mark.parametrize(
    ("what", "patience", "says"),
    [
        ("dies", PATIENCE, ""),
        ("is stopped", PATIENCE, ", since it is frozen"),
        ("hangs", 1.0, ", since it has done nothing for 1 s"),
        ("its child hangs", 1.0, ", since it has done nothing for 1 s"),
    ],
)
def test_what_is_killed_or_stands_still_is_started_again(
    do: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    what: str,
    patience: float,
    says: str,
) -> None:
    monkeypatch.setattr(standstill, "FROZEN_AFTER", 0.5)
    assert do(1, what, patience) == 2
    told = capsys.readouterr().out
    assert told == f"data: was killed by SIGKILL{says}; starts again in 0.001 s (1 of {LIMIT})\n"


def test_what_is_killed_too_often_is_given_up(do: Callable[..., int], tmp_path: Path) -> None:
    with pytest.raises(DiedError) as died:
        do(100, "dies")
    assert (died.value.restarts, died.value.explained) == (LIMIT, False)
    assert len((tmp_path / "count").read_text()) == 1 + LIMIT


@pytest.mark.parametrize(("what", "told"), [("fails", False), ("refuses", True)])
def test_what_fails_by_itself_is_not_tried_again(
    do: Callable[..., int], tmp_path: Path, what: str, told: bool
) -> None:
    with pytest.raises(DiedError) as died:
        do(1, what)
    assert (died.value.restarts, died.value.explained) == (0, told)
    assert len((tmp_path / "count").read_text()) == 1


def test_all_are_done_side_by_side(tmp_path: Path) -> None:
    """Two that wait for each other: each opens its end of a FIFO, and is held until both have."""
    meeting = tmp_path / "meeting"
    os.mkfifo(meeting)
    commands = {
        name: (sys.executable, "-c", f"open({str(meeting)!r}, {mode!r})")
        for name, mode in (("one", "w"), ("two", "r"))
    }
    with Signals() as signals, Supervisor(signals) as supervisor:
        run_one_off(commands, lambda name: tmp_path / f"{name}.log", supervisor, signals, 10.0)
        assert supervisor.running == ()


def test_a_signal_ends_it_all(
    do: Callable[..., int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        standstill.Standstill, "look", lambda *_: os.kill(os.getpid(), signal.SIGTERM)
    )
    with pytest.raises(StoppedError):
        do(1, "hangs")


def test_who_works_or_only_looks_now_and_then_does_not_stand_still() -> None:
    """As who waits for a lock, and tells nobody."""
    for working in ("while True: pass", "import time\nwhile True: time.sleep(0.05)"):
        with subprocess.Popen([sys.executable, "-c", working], process_group=0) as process:
            try:
                watched = standstill.Standstill(process.pid, patience=1.0)
                end = time.monotonic() + 2.5
                while time.monotonic() < end:
                    assert watched.look(time.monotonic()) == ""
            finally:
                process.kill()
