"""Whatever becomes of the streams that a process writes to, its work is done to the end."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from otc_dist.terminal.progress import redraws

WORK = """
import os, pathlib, sys
from rich.console import Console
from otc_dist.terminal.errors import run_main

def work(argv):
    for stream in (sys.stdout, sys.stderr):
        for _ in range(3):
            print("similarity \U0001d53b \xb7 " + "x" * 70_000, file=stream, flush=True)
        Console(file=stream, force_terminal=True).print("[red]coloured")
    descriptor = os.open(argv[0], os.O_WRONLY | os.O_CREAT)
    os.write(descriptor, f"done {descriptor > 2}".encode())
    return 0

run_main(work)
"""
SHELL = 'exec "$0" -c "$1" "$2"'


def _gone_reader() -> int:
    reading, writing = os.pipe()
    os.close(reading)
    return writing


def _gone_terminal() -> int:
    master, terminal = pty.openpty()
    os.close(master)
    return terminal


STREAMS = {
    "a full disk": lambda: os.open("/dev/full", os.O_WRONLY),
    "a pipe that nobody reads": _gone_reader,
    "a terminal that has vanished": _gone_terminal,
}


@pytest.mark.parametrize("stream", STREAMS)
def test_what_cannot_be_written_ends_nothing(tmp_path: Path, stream: str) -> None:
    target = STREAMS[stream]()
    try:
        command = [sys.executable, "-c", WORK, str(tmp_path / "done")]
        assert subprocess.run(command, stdout=target, stderr=target, timeout=60).returncode == 0
    finally:
        os.close(target)
    assert (tmp_path / "done").read_text() == "done True"


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_stream_that_was_closed_is_no_file_that_is_opened_later(
    tmp_path: Path, closed: str
) -> None:
    command = ["sh", "-c", f"{SHELL} {closed}", sys.executable, WORK, str(tmp_path / "done")]
    result = subprocess.run(command, capture_output=True, timeout=60)
    assert result.returncode == 0, result.stderr[-500:]
    assert (tmp_path / "done").read_text() == "done True"


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_characters_that_a_stream_has_not_are_replaced(tmp_path: Path, encoding: str) -> None:
    result = subprocess.run(
        [sys.executable, "-c", WORK, str(tmp_path / "done")],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": encoding},
        timeout=60,
    )
    assert result.returncode == 0, result.stderr[-500:]
    shown = "\U0001d53b \xb7".encode(encoding, "replace")
    assert result.stdout.count(b"similarity " + shown) == 3
    assert (tmp_path / "done").exists()


def test_a_file_is_not_drawn_over_whatever_the_environment_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rich.console import Console

    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    with (tmp_path / "file").open("w") as file:
        console = Console(file=file)
        assert console.is_terminal and not redraws(console)


def test_a_line_takes_the_place_of_a_bar_that_another_process_draws() -> None:
    say = [sys.executable, "-c", "from otc_dist.terminal.progress import beside; beside('done')"]
    master, terminal = pty.openpty()
    try:
        bare = {**os.environ, "TERM": "xterm"}
        subprocess.run(say, stderr=terminal, env=bare, check=True, timeout=60)
        assert os.read(master, 100) == b"\r\x1b[2Kdone\r\n"
    finally:
        os.close(master)
        os.close(terminal)
    assert subprocess.run(say, capture_output=True, check=True).stderr == b"done\n"
