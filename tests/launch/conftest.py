"""Starts real launchers, finds the processes of a run, and compares what two runs ended with."""

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from otc_dist.run.folder import RunFolder

AGENTS = ("agent_0", "agent_1", "agent_2")  # of the runs here
CHECKSUM = 4  # the last bytes of a logged step, which differ with the run's name
_MODULES = ("otc_dist.services", "otc_dist.track", "otc_dist.view")
DEADLINE = 600.0  # seconds: a test that waits longer has failed


class Hold:
    """A point at which a process of a run waits until the test has done what it is about.

    A tiny run is through before a busy machine lets the test look at it, so the test does not look
    for the moment but makes it last.

    Args:
        process: "host" or an agent.
        phase, deployment: where it waits, having said that it is there.
        gate: a path for the FIFO at which it waits.
    """

    def __init__(self, process: str, phase: str, deployment: int, gate: Path) -> None:
        self._gate = gate
        os.mkfifo(gate)
        self.environment = {
            "OTC_TEST_HOLD": f"{process} {phase} {deployment} {gate}",
            "PYTHONPATH": str(Path(__file__).parent / "held"),
        }

    def release(self) -> None:
        """Let the process go on; it has been seen to be there."""
        self._gate.open("w").close()
        self.lift()

    def set_clock_back(self) -> None:
        """The clocks of all processes, and of those to come, are an hour slow from now on."""
        Path(f"{self._gate}.slow").touch()

    def lift(self) -> None:
        """Whoever comes there from now on is not held; who waits there waits for its end."""
        self._gate.unlink(missing_ok=True)


class Launcher:
    """A launcher process whose output is read line by line.

    Args:
        prefix: what its command line begins with.
        cache: a cache of data sets other than that of all tests.
        hold: where one of its processes waits for the test.
    """

    def __init__(
        self,
        *arguments: str,
        cwd: Path,
        prefix: Sequence[str] = (),
        cache: Path | None = None,
        hold: Hold | None = None,
    ) -> None:
        added = {"OTC_DIST_CACHE": str(cache)} if cache else {}
        added |= hold.environment if hold else {}
        self.lines: list[str] = []
        self.process = subprocess.Popen(
            [*prefix, sys.executable, "-m", "otc_dist.launch", *arguments],
            cwd=cwd,
            env={**os.environ, **added},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            bufsize=0,
        )
        self._rest = b""

    @property
    def text(self) -> str:
        return "\n".join(self.lines)

    def read_until(self, wanted: Callable[[str], bool]) -> str:
        """The first line from here on that `wanted` accepts."""
        while (line := self._line()) is not None:
            if wanted(line):
                return line
        raise AssertionError(f"the launcher ended before it was said:\n{self.text}")

    def finish(self) -> int:
        """Read to the end; the exit status."""
        while self._line() is not None:
            pass
        return self.process.wait(DEADLINE)

    def _line(self) -> str | None:
        assert self.process.stdout is not None
        while b"\n" not in self._rest:
            ready, _, _ = select.select([self.process.stdout], [], [], DEADLINE)
            assert ready, f"silence for {DEADLINE} s after:\n{self.text}"
            read = os.read(self.process.stdout.fileno(), 65536)
            if not read:
                return None
            self._rest += read
        line, self._rest = self._rest.split(b"\n", 1)
        self.lines.append(line.decode(errors="replace"))
        return self.lines[-1]


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Callable[..., Launcher]]:
    """Start a launcher in a folder of the test's own; it is gone when the test ends."""
    started: list[Launcher] = []

    def start(*arguments: str, cwd: Path = tmp_path, **how: Any) -> Launcher:
        started.append(Launcher(*arguments, cwd=cwd, **how))
        return started[-1]

    yield start
    for launcher in started:
        if launcher.process.poll() is None:
            launcher.process.send_signal(signal.SIGTERM)
            launcher.process.wait(DEADLINE)
        assert launcher.process.stdout is not None
        launcher.process.stdout.close()


def processes_of(run: Path) -> dict[str, int]:
    """Services of that run, and what is beside it, alive now: command line -> process id."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            command = (entry / "cmdline").read_bytes().decode().split("\0")
        except (OSError, UnicodeDecodeError):
            continue  # it ended meanwhile, or is no process
        ours = any(word.startswith(_MODULES) for word in command)
        if str(run) in command and ours:
            found[" ".join(command[1:])] = int(entry.name)
    return found


def wait_for_end(pids: list[int]) -> None:
    """Return when all these processes have ended; fail at the deadline."""
    for pid in pids:
        try:
            handle = os.pidfd_open(pid)
        except ProcessLookupError:
            continue
        try:
            ready, _, _ = select.select([handle], [], [], DEADLINE)
        finally:
            os.close(handle)
        assert ready, f"process {pid} still runs"


def outcome(folder: RunFolder, learners: Sequence[RunFolder] = ()) -> dict[str, object]:
    """All that must not depend on what happened on the way: weights, logs, returns.

    `learners`: where the agents' checkpoints lie, if not in the same folder.
    """
    found: dict[str, object] = {}
    for index, agent in enumerate(AGENTS):
        own = learners[index] if learners else folder
        for k in range(3):
            found[f"{agent} {k}"] = own.checkpoint(agent, k).read_bytes()
    for k in (1, 2):
        with folder.deployment(k).open("rb") as file:
            found[f"deployment {k}"] = [
                (channel.topic, message.sequence, message.data[:-CHECKSUM])
                for _, channel, message in make_reader(file).iter_messages("joint_step")
            ]
    for k in range(3):
        found[f"evaluation {k}"] = json.loads(folder.evaluation(k).read_text())["returns"]
    return found


@pytest.fixture(scope="session")
def finished(
    tmp_path_factory: pytest.TempPathFactory, tiny_flags: tuple[str, ...]
) -> tuple[RunFolder, Launcher]:
    """An undisturbed run, and the launcher that it ended with."""
    place = tmp_path_factory.mktemp("finished")
    launcher = Launcher("3agent_hopper", *tiny_flags, "--out", "run", cwd=place)
    assert launcher.finish() == 0, launcher.text
    return RunFolder(place / "run"), launcher


def same(folder: RunFolder, reference: RunFolder, learners: Sequence[RunFolder] = ()) -> None:
    """Assert that two runs ended with the same bytes; `learners` as for `outcome`."""
    ours, theirs = outcome(folder, learners), outcome(reference)
    assert ours.keys() == theirs.keys()
    assert [name for name in ours if ours[name] != theirs[name]] == []
