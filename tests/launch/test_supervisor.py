"""The supervisor with real processes. A FIFO that they hold open tells when all have ended."""

import os
import pty
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from otc_dist.launch.supervise.signals import Signals
from otc_dist.launch.supervise.supervisor import Supervisor

DEADLINE = 60.0

# Opens the FIFO, says so, and waits; a grandchild does the same, in the same process group.
FAMILY = """
import os, subprocess, sys, time
held = open(sys.argv[1], "w")
inner = '''
import sys, time
held = open(sys.argv[1], "w"); held.write("."); held.flush()
time.sleep(600)
'''
child = subprocess.Popen([sys.executable, "-c", inner, sys.argv[1]])
held.write("."); held.flush()
time.sleep(600)
"""
DEAF = """
import signal, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
held = open(sys.argv[1], "w"); held.write("."); held.flush()
time.sleep(600)
"""


class Fifo:
    """Counts the dots that processes write into it, and sees when the last has let go."""

    def __init__(self, path: Path) -> None:
        os.mkfifo(path)
        self.path = str(path)
        self._handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)

    def wait_for(self, dots: int) -> None:
        while dots > 0:
            assert select.select([self._handle], [], [], DEADLINE)[0], "nobody wrote"
            dots -= len(os.read(self._handle, dots))

    def wait_for_end(self) -> None:
        ready, _, _ = select.select([self._handle], [], [], DEADLINE)
        assert ready and os.read(self._handle, 1) == b"", "a process still holds it"
        os.close(self._handle)


@pytest.fixture
def fifo(tmp_path: Path) -> Fifo:
    return Fifo(tmp_path / "held")


def _python(code: str, *arguments: str) -> list[str]:
    return [sys.executable, "-c", code, *arguments]


def test_stop_ends_a_process_and_what_it_started(fifo: Fifo) -> None:
    with Signals() as signals, Supervisor(signals) as supervisor:
        supervisor.start("family", _python(FAMILY, fifo.path))
        fifo.wait_for(2)
        (end,) = supervisor.stop()
    assert (end.process, end.status) == ("family", -signal.SIGTERM)
    fifo.wait_for_end()


def test_leaving_the_context_stops_everything(fifo: Fifo) -> None:
    with pytest.raises(RuntimeError), Signals() as signals, Supervisor(signals) as supervisor:
        supervisor.start("family", _python(FAMILY, fifo.path))
        fifo.wait_for(2)
        raise RuntimeError
    fifo.wait_for_end()


def test_a_process_that_ignores_sigterm_is_killed(
    fifo: Fifo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("otc_dist.launch.supervise.supervisor.GRACE", 0.3)
    with Signals() as signals, Supervisor(signals) as supervisor:
        supervisor.start("deaf", _python(DEAF, fifo.path))
        fifo.wait_for(1)
        (end,) = supervisor.stop()
    assert end.status == -signal.SIGKILL
    assert end.manner == "was killed by SIGKILL"
    fifo.wait_for_end()


def test_a_second_interrupt_kills_at_once(fifo: Fifo) -> None:
    with Signals() as signals, Supervisor(signals) as supervisor:
        supervisor.start("deaf", _python(DEAF, fifo.path))
        fifo.wait_for(1)
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        assert (signals.stop, signals.repeated) == (signal.SIGINT, True)
        (end,) = supervisor.stop()
    assert end.status == -signal.SIGKILL


def test_an_end_is_reported_once_with_its_last_lines(tmp_path: Path) -> None:
    output = tmp_path / "output" / "p.log"
    with Signals() as signals, Supervisor(signals) as supervisor:
        supervisor.start("p", _python("print('one'); print('two'); raise SystemExit(3)"), output)
        while not (ends := supervisor.ended()):
            signals.wait(DEADLINE)  # its end wakes us
        assert supervisor.ended() == []
    assert [(e.process, e.manner) for e in ends] == [("p", "exited with status 3")]
    assert ends[0].last_lines(1) == ["two"]


def test_children_get_one_thread_and_no_terminal(tmp_path: Path) -> None:
    code = "import os, sys; print(os.environ['OMP_NUM_THREADS'], repr(sys.stdin.read()))"
    output = tmp_path / "p.log"
    with Signals() as signals, Supervisor(signals) as supervisor:
        supervisor.start("p", _python(code), output)
        while not supervisor.ended():
            signals.wait(DEADLINE)
    assert output.read_text() == "1 ''\n"


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's death signal is Linux's")
def test_killing_the_launcher_kills_its_processes(fifo: Fifo) -> None:
    launcher = """
import sys
from otc_dist.launch.supervise.signals import Signals
from otc_dist.launch.supervise.supervisor import Supervisor
with Signals() as signals, Supervisor(signals) as supervisor:
    supervisor.start("deaf", [sys.executable, "-c", sys.argv[1], sys.argv[2]])
    while True:
        signals.wait(600)
"""
    with subprocess.Popen(_python(launcher, DEAF, fifo.path)) as process:
        fifo.wait_for(1)
        process.kill()
    fifo.wait_for_end()


HANGS_UP = """
import os, pathlib, signal, sys
from otc_dist.terminal import output
from otc_dist.launch.supervise.signals import Signals
from otc_dist.launch.supervise.supervisor import Supervisor
output.steady()
if sys.argv[3] == "nohup":
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
with Signals() as signals, Supervisor(signals) as supervisor:
    supervisor.start("child", [sys.executable, "-c", sys.argv[1], sys.argv[2]])
    while not signals.stop:
        signals.wait(600)
print("stopped by", signals.stop.name, flush=True)  # to nobody
supervisor.stop()
pathlib.Path(sys.argv[4]).write_text(signals.stop.name)
"""


@pytest.mark.parametrize("how", ["nohup", "login"])
def test_a_terminal_that_vanishes_ends_what_it_started_in_order_unless_hangups_are_ignored(
    fifo: Fifo, tmp_path: Path, how: str
) -> None:
    """The kernel sends SIGHUP to who leads the session, as for a launcher typed into `ssh -t`."""
    pid, terminal = pty.fork()
    if pid == 0:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests themselves may be run by nohup
        command = _python(HANGS_UP, FAMILY, fifo.path, how, str(tmp_path / "stopped"))
        os.execv(command[0], command)
    fifo.wait_for(2)
    os.close(terminal)
    if how == "nohup":
        handle = os.pidfd_open(pid)
        assert select.select([handle], [], [], 1.0)[0] == [], "the hangup ended it"
        os.close(handle)
        os.kill(pid, signal.SIGTERM)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    assert (tmp_path / "stopped").read_text() == ("SIGTERM" if how == "nohup" else "SIGHUP")
    fifo.wait_for_end()
