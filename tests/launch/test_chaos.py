"""A short form of `launch chaos`: faults of several kinds strike one run, which ends the same."""

import subprocess
import sys
from pathlib import Path

import pytest

from otc_dist.errors import UserError
from otc_dist.launch.__main__ import main


@pytest.mark.parametrize(
    ("faults", "says"),
    [(["kill-hots=1"], "did you mean 'kill-host'?"), (["freeze"], "write it as freeze=20")],
)
def test_a_mistake_is_one_line(faults: list[str], says: str) -> None:
    with pytest.raises(UserError) as caught:
        main(["chaos", *faults])
    assert says in str(caught.value)


def test_a_folder_that_cannot_be_made_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("otc_dist.launch.chaos_arena.enter", lambda: None)  # it would leave pytest
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"cannot make the folder .*/file/out"):
        main(["chaos", "--out", str(tmp_path / "file" / "out")])


@pytest.mark.slow
def test_whatever_strikes_the_run_ends_with_the_same_bytes(tmp_path: Path) -> None:
    """Its kinds that need namespaces, or a tool that is missing, are told as skipped."""
    faults = ("kill-router=1", "fill-disk=1", "lose-5%=1", "any=2")
    done = subprocess.run(
        [sys.executable, "-m", "otc_dist.launch", "chaos", *faults, "--out", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for fault, line in zip(faults, done.stdout.splitlines()[-len(faults) :], strict=True):
        name, count = fault.split("=")
        assert line.split()[0] == name
        struck, runs, identical, *_ = line.split()[1:]
        if struck != "skipped:":
            assert (struck, runs) == (count, identical)
    assert not (tmp_path / "wrong").exists()
