"""Mistakes are answered in one line that says what is wrong."""

import io
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.writer import Writer

from otc_dist.deployment_log.reader import read_header, read_steps, read_transitions
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.terminal.errors import UserError


def said(path: Path) -> str:
    with pytest.raises(UserError) as caught:
        read_header(path)
    message = str(caught.value)
    assert "\n" not in message and str(path) in message
    return message


def test_no_file(tmp_path: Path) -> None:
    assert "No such file" in said(tmp_path / "none.mcap")


def test_a_folder(tmp_path: Path) -> None:
    assert "a run's logs are RUN/deployments/deployment_*.mcap" in said(tmp_path)


@pytest.mark.parametrize("content", [b"", b"short", b"a,b\n" * 100])
def test_no_mcap_file(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(content)
    assert "not an MCAP file" in said(path)


@pytest.mark.parametrize("size", [1, 8, 10, 40, 60, 500])
def test_a_log_that_ends_within_its_header(tmp_path: Path, small, size: int) -> None:
    path = small.finish(tmp_path / "log.mcap")
    path.write_bytes(path.read_bytes()[:size])
    assert f"too short to hold the header of a deployment log: {size} bytes" in said(path)


def test_another_profile(tmp_path: Path) -> None:
    out = io.BytesIO()
    writer = Writer(out)
    writer.start(profile="ros2")
    writer.finish()
    path = tmp_path / "bag.mcap"
    path.write_bytes(out.getvalue())
    assert "profile 'ros2', not 'x-otc-dist'" in said(path)


@pytest.mark.parametrize(("version", "word"), [(4, "newer"), (0, "older")])
def test_another_version_names_both(tmp_path: Path, small, version: int, word: str) -> None:
    small.header = replace(small.header, format_version=version)
    path = tmp_path / "log.mcap"
    small.write(path, stop=0).close()
    message = said(path.with_name("log.mcap.partial"))
    assert f"log version {version}, {word} than" in message
    assert f"version {3 if word == 'newer' else 1}" in message
    with pytest.raises(UserError, match=word):
        LogWriter.resume(path)


def test_an_unknown_agent(tmp_path: Path, small) -> None:
    path = small.finish(tmp_path / "log.mcap")
    with pytest.raises(UserError, match=r"no agent 'agent_9'; it has agent_0, agent_1"):
        read_transitions(path, "agent_9")


def test_a_recorded_deployment_is_never_replaced(tmp_path: Path, small) -> None:
    path = tmp_path / "log.mcap"
    writer = small.write(path)
    with pytest.raises(FileExistsError):
        LogWriter.create(path, small.header)
    writer.finish({})
    with pytest.raises(FileExistsError):
        LogWriter.create(path, small.header)
    assert sum(1 for _ in read_steps(path)) == 12


def test_only_one_process_writes_a_log(tmp_path: Path, small) -> None:
    path = tmp_path / "log.mcap"
    writer = small.write(path)
    with pytest.raises(UserError, match="being written by another process"):
        LogWriter.resume(path)
    writer.close()
    LogWriter.resume(path)[0].close()


def test_resuming_nothing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        LogWriter.resume(tmp_path / "log.mcap")


def test_too_many_copies(tmp_path: Path, small) -> None:
    with pytest.raises(UserError, match=r"env.copies = 1000000 makes log records of .* MiB"):
        LogWriter.create(tmp_path / "log.mcap", replace(small.header, copies=10**6))
    assert list(tmp_path.iterdir()) == []
