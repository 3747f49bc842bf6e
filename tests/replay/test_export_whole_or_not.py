"""An export is there whole, or nothing is: what exists, is missing, is full, or interrupts."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.system.extras import install

from .conftest import Replay
from .played import play
from .recorded import Deployments


def test_an_export_that_exists_is_replaced_only_by_force_and_nothing_else_ever(
    hopper: Deployments, replay: Replay, refused: Callable[..., str], tmp_path: Path
) -> None:
    command = (*hopper.paths[:1], "--export", "csv", "--out", tmp_path / "out")
    replay(*command)
    before = (tmp_path / "out" / "agent_0.csv").read_bytes()
    assert "--force" in refused(*command)
    replay(*command, "--force", "--steps", "0:10")
    assert len((tmp_path / "out" / "agent_0.csv").read_bytes()) < len(before)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").touch()
    message = refused(*command[:-1], tmp_path / "mine", "--force")
    assert "something else" in message
    assert (tmp_path / "mine" / "letter.txt").exists()


def test_mistakes_are_one_line(
    hopper: Deployments, refused: Callable[..., str], tmp_path: Path
) -> None:
    out = ("--export", "csv", "--out", tmp_path / "out")
    assert "--out" in refused(*hopper.paths, "--export", "csv")
    assert "has no agent 'agent_9'" in refused(*hopper.paths, *out, "--agent", "agent_9")
    play("navigation", tmp_path / "other.mcap", 5, run="r", deployment=3)
    assert "of navigation" in refused(*hopper.paths, tmp_path / "other.mcap", *out)
    (tmp_path / "text.mcap").write_text("hello")
    assert "is not an MCAP file" in refused(tmp_path / "text.mcap", *out)
    damaged = bytearray(hopper.paths[0].read_bytes())
    damaged[len(damaged) // 3] ^= 1
    (tmp_path / "damaged.mcap").write_bytes(damaged)
    assert "is damaged" in refused(tmp_path / "damaged.mcap", *out)
    assert not any(path.name.startswith((".out", "out")) for path in tmp_path.iterdir())


@pytest.mark.parametrize(
    ("form", "library", "extra"),
    [
        ("csv", "pyarrow", "export"),
        ("d4rl", "h5py", "export"),
        ("minari", "minari", "export"),
        ("vault", "tensorstore", "vault"),
    ],
)
def test_without_its_library_the_extra_is_named(
    hopper: Deployments,
    refused: Callable[..., str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    form: str,
    library: str,
    extra: str,
) -> None:
    for module in [name for name in sys.modules if name.startswith("otc_dist.replay.export.")]:
        if not module.endswith(("formats", "trajectories", "command", "disk_space")):
            monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, library, None)
    message = refused(hopper.paths[0], "--export", form, "--out", tmp_path / "out")
    assert install(extra) in message and library in message


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
from otc_dist.terminal.errors import run_main
from otc_dist.replay.__main__ import main
run_main(main)
"""


@pytest.mark.parametrize("form", ["minari", "parquet", "vault"])
def test_without_room_on_the_disk_nothing_is_left_behind(
    hopper: Deployments, tmp_path: Path, form: str
) -> None:
    """No file may grow beyond 200 kB: to the program as if the disk were full."""
    arguments = (str(hopper.paths[0]), "--export", form, "--out", str(tmp_path / "out"))
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, *arguments],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    (line,) = done.stderr.splitlines()
    assert (done.returncode, line) == (2, f"error: cannot write {tmp_path / 'out'}: File too large")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_export_leaves_nothing_behind(
    hopper: Deployments, replay: Replay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("otc_dist.replay.export.command.require_space", interrupt)
    with pytest.raises(KeyboardInterrupt):
        replay(*hopper.paths, "--export", "lerobot", "--out", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
