"""Files that are no logs of ours are answered in one line, and nothing changes."""

import io
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.writer import Writer

from otc_dist.deployment_log.writer import LogWriter
from tests.deployment_log.conftest import Recording

ACTIONS = {
    "summary": (),
    "verify": ("--verify",),
    "recover": ("--recover",),
    "publish": ("--publish",),
    "export": ("--export", "csv", "--out", "{}/out"),
    "html": ("--html", "{}/out.html"),
}
FILES = {
    "missing": "No such file",
    "empty": "is ",
    "text": "is not an MCAP file",
    "bag": "profile",
    "newer": "is of log version 4, newer than what this otc_dist",
}


def _write(path: Path, kind: str) -> None:
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "text":
        path.write_text("a,b\n1,2\n" * 100)
    elif kind == "bag":
        out = io.BytesIO()
        writer = Writer(out)
        writer.start(profile="ros2")
        writer.finish()
        path.write_bytes(out.getvalue())
    elif kind == "newer":
        made = Recording(((3, 1), (2, 2)), copies=2, steps=3)
        writer = LogWriter.create(path, replace(made.header, format_version=4))
        writer.close()
        path.with_name(path.name + ".partial").rename(path)


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("action", ACTIONS)
def test_what_is_no_log_of_ours(tmp_path: Path, refused, action: str, kind: str) -> None:
    path = tmp_path / "log.mcap"
    _write(path, kind)
    before = {p.name for p in tmp_path.iterdir()}
    message = refused(path, *(part.format(tmp_path) for part in ACTIONS[action]))
    assert FILES[kind] in message and str(path) in message
    if kind == "newer":
        assert "at most version 3" in message
    assert {p.name for p in tmp_path.iterdir()} == before


@pytest.mark.parametrize("action", [action for action in ACTIONS if action != "recover"])
def test_a_damaged_log_points_to_recover(
    recorded: tuple[Recording, Path], tmp_path: Path, replay, refused, action: str
) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(recorded[1].read_bytes()[:-100])
    arguments = (path, *(part.format(tmp_path) for part in ACTIONS[action]))
    if action == "verify":
        status, message = replay(*arguments)
        assert status == 1
    else:
        message = refused(*arguments)
    assert "is damaged" in message and "; --recover writes what is whole" in message
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--out", "foo"], "--out does nothing without an action; it is for --export, --recover"),
        (["--force"], "--force does nothing without an action"),
        (["--rate", "2"], "--rate does nothing without an action; it is for --publish"),
        (["--run", "r"], "--run does nothing without an action"),
        (["--learners", "--verify"], "--learners does nothing with --verify"),
        (["--verify", "--out", "foo"], "--out does nothing with --verify"),
        (["--recover", "--steps", "0:5"], "--steps does nothing with --recover"),
        (["--recover", "--agent", "agent_0"], "--agent does nothing with --recover"),
        (["--html", "a.html", "--out", "b.html"], "--out does nothing with --html"),
        (["--export", "csv", "--accept-unbound"], "--accept-unbound does nothing with --export"),
        (["--video", "film.gif"], "--video writes .mp4, and film.gif ends differently"),
        (["--sheet", "film.jpg"], "--sheet writes .png"),
        (["--html", "page.pdf"], "--html writes .html"),
        (["--foxglove", "all.bag"], "--foxglove writes .mcap"),
    ],
)
def test_what_would_do_nothing_or_be_misnamed_is_refused(
    recorded: tuple[Recording, Path], refused, arguments: list[str], said: str
) -> None:
    assert said in refused(recorded[1], *arguments)


# What writes a file or a folder -> how; {} is where to.
_WRITES = {
    "recover": ("--recover", "--out", "{}", "--force"),
    "foxglove": ("--foxglove", "{}", "--force"),
    "html": ("--html", "{}", "--force"),
    "sheet": ("--sheet", "{}", "--force"),
    "video": ("--video", "{}", "--force"),
    "export": ("--export", "csv", "--out", "{}", "--force"),
}
_NAMES = {
    "itself": lambda path, beside: path,
    "a relative path": lambda path, beside: Path(os.path.relpath(path)),
    "a symlink": lambda path, beside: beside.symlink_to(path) or beside,
    "a hard link": lambda path, beside: beside.hardlink_to(path) or beside,
}


@pytest.mark.parametrize("action", _WRITES)
@pytest.mark.parametrize("named", _NAMES)
def test_what_is_read_is_never_replaced(
    recorded: tuple[Recording, Path], tmp_path: Path, refused, action: str, named: str
) -> None:
    path = tmp_path / "log"  # which has no ending that a picture could not have
    path.write_bytes(recorded[1].read_bytes())
    out = _NAMES[named](path, tmp_path / "other")
    there = {p: p.read_bytes() for p in tmp_path.iterdir()}
    message = refused(path, *(part.format(out) for part in _WRITES[action]))
    assert message == f"{out} is what is read, or holds it: write to another place"
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == there


def test_an_unfinished_log_is_not_replaced_by_its_full_name(
    recorded: tuple[Recording, Path], tmp_path: Path, refused
) -> None:
    """`log.mcap` stands for it where only `log.mcap.partial` is there."""
    partial = tmp_path / "log.mcap.partial"
    partial.write_bytes(recorded[1].read_bytes()[:-100])
    recover = (tmp_path / "log.mcap", "--recover", "--force", "--out", partial)
    assert "is what is read" in refused(*recover)
    assert partial.stat().st_size == recorded[1].stat().st_size - 100


@pytest.mark.parametrize("action", _WRITES)
def test_force_takes_no_folder_away(
    recorded: tuple[Recording, Path], tmp_path: Path, refused, action: str
) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "letter.txt").touch()
    message = refused(recorded[1], *(part.format(folder) for part in _WRITES[action]))
    assert message.startswith(f"{folder} is a folder")
    assert (folder / "letter.txt").exists()


def test_an_export_takes_no_log_away_that_lies_in_an_earlier_one(
    recorded: tuple[Recording, Path], tmp_path: Path, replay, refused
) -> None:
    out = tmp_path / "out"
    replay(recorded[1], "--export", "csv", "--out", out)
    inside = out / "log.mcap"
    inside.write_bytes(recorded[1].read_bytes())
    assert "holds it" in refused(inside, "--export", "csv", "--out", out, "--force")
    assert inside.exists()


def test_several_logs_are_not_recovered_over_each_other(
    recorded: tuple[Recording, Path], tmp_path: Path, refused
) -> None:
    logs = [tmp_path / name for name in ("a.mcap", "a.mcap.partial", "a.recovered.mcap")]
    for log in logs:
        log.write_bytes(recorded[1].read_bytes())
    assert "would be written twice" in refused(*logs[:2], "--recover", "--force")
    assert "is what is read" in refused(logs[0], logs[2], "--recover", "--force")
    assert [log.read_bytes() for log in logs] == [recorded[1].read_bytes()] * 3


def test_the_line_goes_to_the_error_output_and_the_status_is_2(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "otc_dist.replay", str(tmp_path / "none.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr
        == f"error: {tmp_path / 'none.mcap'} cannot be read: No such file or directory\n"
    )
