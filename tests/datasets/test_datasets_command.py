"""`python -m otc_dist.datasets`: what a user sees, in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from .recordings import play, write_d4rl


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("command")


def run(cache: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "otc_dist.datasets", *arguments],
        env={**os.environ, "OTC_DIST_CACHE": str(cache)},
        cwd=cache.parent,
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_a_set_is_made_then_listed_then_shown(cache: Path) -> None:
    made = run(cache, "make", "hopper-3x1/random", "--transitions", "900")
    assert made.returncode == 0, made.stderr
    assert "900 of 900 transitions" in made.stderr
    listed = run(cache, "list")
    assert listed.returncode == 0
    line = next(x for x in listed.stdout.splitlines() if x.startswith("hopper-3x1/random "))
    assert line.split()[:3] == ["hopper-3x1/random", "1,000,000", "900"]
    assert "walker2d-1x6/medium-replay" in listed.stdout
    for shown in (
        run(cache, "show", "hopper-3x1/random"),  # the only size that is there
        run(cache, "show", "hopper-3x1/random", "--transitions", "900"),
    ):
        assert (shown.returncode, shown.stdout) == (0, made.stdout)
        for part in ("normalised score", "mujoco", "agent_2", "sha256", "complete"):
            assert part in shown.stdout


def test_a_file_is_imported_and_then_known(cache: Path) -> None:
    file = write_d4rl(cache / "hopper_x.hdf5", play("hopper-1x3", 60))
    imported = run(cache, "import", str(file), "--name", "mine")
    assert imported.returncode == 0, imported.stderr
    assert "hopper-3x1/mine" in imported.stdout
    assert "hopper-3x1/mine" in run(cache, "list").stdout
    assert run(cache, "make", "hopper-3x1/mine").stdout == imported.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("make", "hopper-3x1/medum"), "did you mean 'hopper-3x1/medium'?"),
        (("make", "hopper-3x1/random", "--transitions", "-5"), "ask for 1 or more, not -5"),
        (("show", "walker2d-2x3/medium"), "make walker2d-2x3/medium"),
        (("import", "absent.hdf5", "--name", "x"), "absent.hdf5"),
        (("import", ".", "--name", "x", "--env", "hoper-3x1"), "hdf5"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(
    cache: Path, arguments: tuple[str, ...], message: str
) -> None:
    result = run(cache, *arguments)
    assert result.returncode == 2
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
    assert message in line


def test_show_notices_a_damaged_file(cache: Path) -> None:
    run(cache, "make", "hopper-1x3/random", "--transitions", "300")
    file = cache / "datasets" / "hopper-1x3" / "random" / "300" / "agent_0.safetensors"
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)
    result = run(cache, "show", "hopper-1x3/random")
    assert result.returncode == 2
    assert "does not match its sha256" in result.stderr


def test_a_cache_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    result = run(file, "make", "hopper-1x3/random", "--transitions", "10")
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert "set OTC_DIST_CACHE" in line


def test_help_teaches(cache: Path) -> None:
    text = run(cache, "--help").stdout
    for part in ("medium-replay", "examples:", "import", "OTC_DIST_CACHE", str(cache)):
        assert part in text
