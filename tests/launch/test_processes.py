"""Supervision of real processes: started again when they die, given up when that is of no use."""

import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from otc_dist.bus.keys import HOST, Uses
from otc_dist.launch.plan import descriptions
from otc_dist.launch.plan.placement import Placement
from otc_dist.launch.plan.plan import Plan, Process
from otc_dist.launch.run.resolve import resolve
from otc_dist.launch.supervise import health
from otc_dist.launch.supervise.observer import Token
from otc_dist.launch.supervise.processes import DiedError, RunProcesses
from otc_dist.launch.supervise.signals import Signals
from otc_dist.launch.supervise.supervisor import Supervisor
from otc_dist.run.folder import RunFolder
from otc_dist.spec import TeamSpec

# Appends a letter to a file, and ends well once it has as many as it is told.
COUNT = """
import sys
path, enough, status = sys.argv[1:]
with open(path, "a+") as file:
    file.write("x"); file.seek(0); count = len(file.read())
raise SystemExit(0 if count >= int(enough) else int(status))
"""


@pytest.fixture
def processes_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., RunProcesses]]:
    """Supervision of processes with these commands, which restarts at once."""
    monkeypatch.setattr(health, "FIRST_DELAY", 0.001)
    description = resolve(descriptions.load("navigation", ["engine.name=eager"], None, True))
    with Signals() as signals, Supervisor(signals) as supervisor:

        def make(**commands: list[str]) -> RunProcesses:
            processes = tuple(
                Process(name, (sys.executable, "-c", *command), Uses())
                for name, command in commands.items()
            )
            team = TeamSpec("navigation", (), 0, 1)
            plan = Plan(description, RunFolder(tmp_path), team, processes, Placement())
            processes = RunProcesses(plan, supervisor)
            processes.wait = lambda: signals.wait(0.01)  # type: ignore[attr-defined]
            return processes

        yield make


def work(processes: RunProcesses, until: Callable[[], bool] = lambda: False) -> None:
    while processes.at_work and not until():
        processes.start_due()
        processes.wait()  # type: ignore[attr-defined]
        processes.look()


def count(path: Path) -> int:
    return len(path.read_text())


def test_what_dies_is_started_until_it_ends_well(
    processes_of: Callable[..., RunProcesses], tmp_path: Path
) -> None:
    path = tmp_path / "count"
    processes = processes_of(agent_0=[COUNT, str(path), "3", "1"])
    work(processes)
    assert count(path) == 3
    assert processes.health.of_process["agent_0"].restarts == 2
    assert [event.split(";")[0] for event in processes.drain_events()] == [
        "agent_0: exited with status 1"
    ] * 2


def test_what_dies_too_often_is_given_up(
    processes_of: Callable[..., RunProcesses], tmp_path: Path
) -> None:
    path = tmp_path / "count"
    processes = processes_of(agent_0=[COUNT, str(path), "100", "1"])
    with pytest.raises(DiedError) as died:
        work(processes)
    assert count(path) == 1 + health.LIMIT
    assert (died.value.end.process, died.value.restarts) == ("agent_0", health.LIMIT)


def test_a_mistake_of_the_user_s_is_not_tried_again(
    processes_of: Callable[..., RunProcesses], tmp_path: Path
) -> None:
    path = tmp_path / "count"
    with pytest.raises(DiedError):
        work(processes_of(agent_0=[COUNT, str(path), "100", "2"]))
    assert count(path) == 1


def test_a_host_that_starts_again_finds_the_learners_that_had_ended(
    processes_of: Callable[..., RunProcesses], tmp_path: Path
) -> None:
    """It will ask them all once more."""
    go, path = tmp_path / "go", tmp_path / "count"
    wait = "import os, sys, time\n"
    wait += "go = sys.argv.pop()\nwhile not os.path.exists(go): time.sleep(0.01)\n"
    processes = processes_of(
        host=[wait + COUNT, str(tmp_path / "host"), "2", "1", str(go)],
        agent_0=[COUNT, str(path), "0", "1"],
    )
    work(processes, until=lambda: processes.health.of_process["agent_0"].state == "ended")
    go.touch()
    work(processes)
    assert count(tmp_path / "host") == 2
    assert count(path) == 2


@pytest.mark.parametrize("moves", [False, True])
def test_an_env_host_to_whom_nobody_can_come_any_more_is_started_again(
    processes_of: Callable[..., RunProcesses],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    moves: bool,
) -> None:
    """A clean-up has taken the folder of the bus's socket; the links that are there hold.

    Where the folder cannot be made again at the same place, the others are started again, too.
    """
    monkeypatch.setattr("otc_dist.launch.supervise.processes.CLOSING", 0.01)
    path, agent, socket = tmp_path / "count", tmp_path / "agent", tmp_path / ".bus" / "bus"
    places = [socket, tmp_path / "bus" if moves else socket]
    monkeypatch.setattr(Placement, "local_socket", lambda *_: places.pop(0))
    listens = "import pathlib, sys\nsocket = pathlib.Path(sys.argv.pop())\n"
    listens += "socket.parent.mkdir(exist_ok=True)\nsocket.touch()\n"
    waits = "import signal\nif count == 1: signal.pause()\nraise SystemExit"
    waiting = COUNT.replace("raise SystemExit", waits)
    processes = processes_of(
        host=[listens + waiting, str(path), "2", "1", str(socket)],
        agent_0=[waiting if moves else COUNT, str(agent), "0", "1"],
    )
    work(processes, until=socket.exists)
    processes.take(Token(HOST, alive=True))
    work(processes, until=lambda: all(p.exists() and count(p) == 1 for p in (path, agent)))
    assert processes.drain_events() == []
    shutil.rmtree(socket.parent)
    work(processes)
    assert (count(path), count(agent)) == (2, 2)  # who has ended well is asked once more
    assert processes.health.of_process[HOST].last_end == (
        f"was killed by SIGKILL, since it has lost the bus's socket, {socket}"
    )
    told = f"agent_0: waits where the bus was: it is at {tmp_path / 'bus'} now; killed"
    assert (told in processes.drain_events()) == moves


def test_an_env_host_that_takes_its_socket_with_it_ends_by_itself(
    processes_of: Callable[..., RunProcesses], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is not killed for what it has closed, so that its own end is told."""
    path, socket = tmp_path / "count", tmp_path / "bus"
    monkeypatch.setattr(Placement, "local_socket", lambda *_: socket)
    closes = "import pathlib, signal, sys\nsocket = pathlib.Path(sys.argv.pop())\n"
    closes += "signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGUSR1])\nsocket.touch()\n"
    closes += "if not pathlib.Path(sys.argv[1]).exists(): signal.sigwait([signal.SIGUSR1])\n"
    processes = processes_of(host=[closes + COUNT, str(path), "2", "1", str(socket)])
    work(processes, until=socket.exists)
    processes.take(Token(HOST, alive=True))
    socket.unlink()
    for _ in range(3):
        processes.look()
    os.kill(processes.health.of_process[HOST].pid, signal.SIGUSR1)
    work(processes)
    assert processes.health.of_process[HOST].last_end == "exited with status 1"
