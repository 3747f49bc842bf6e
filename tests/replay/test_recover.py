"""`--recover` writes what is whole to a log of its own, whole or not at all."""

import argparse
import json
import resource
from pathlib import Path

import pytest

from otc_dist.datasets.importers import import_files
from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.measuring import read_measured
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import read_header, read_steps, read_summary
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.replay.__main__ import main
from otc_dist.replay.timeline import highlights
from otc_dist.terminal.errors import UserError
from tests.deployment_log.conftest import Recording, again, same_step

from .deployments import described, played


def damaged(recorded: tuple[Recording, Path], folder: Path) -> Path:
    """A copy of the finished log with a hole in its middle, and without its end."""
    data = bytearray(recorded[1].read_bytes()[:-1000])
    data[len(data) // 2 : len(data) // 2 + 100] = bytes(100)
    path = folder / "log.mcap"
    path.write_bytes(data)
    return path


def test_every_whole_step_is_in_the_new_log(
    recorded: tuple[Recording, Path], tmp_path: Path, replay
) -> None:
    made, _ = recorded
    path = damaged(recorded, tmp_path)
    status, output = replay(path, "--recover")
    out = tmp_path / "log.recovered.mcap"
    assert status == 1  # some are missing
    assert output.startswith(f"{out}: ") and "missing: steps " in output
    steps = list(read_steps(out))
    assert 600 < len(steps) < 1200
    assert all(same_step(step, made.steps[step.step]) for step in steps)
    summary = read_summary(out)
    assert summary.steps == len(steps) and len(summary.extent.ranges) == 2
    assert not summary.extent.finished and not summary.extent.whole
    assert "gaps          steps" in replay(out)[1]


@pytest.mark.parametrize("named", ["log.mcap", "log.mcap.partial"])
def test_an_unfinished_log_is_found_by_both_names(tmp_path: Path, replay, named: str) -> None:
    made = Recording(((3, 1), (2, 2)), copies=2, steps=12)
    made.write(tmp_path / "log.mcap").close()
    partial = tmp_path / "log.mcap.partial"
    partial.write_bytes(partial.read_bytes()[:-1])
    status, output = replay(tmp_path / named, "--recover")
    out = tmp_path / "log.recovered.mcap"
    assert status == 1
    assert output == (
        f"{out}: partial: 11 steps, of how many is not known;"
        " missing: none before step 11, and how many follow is not known\n"
    )
    steps = list(read_steps(out))
    assert len(steps) == 11
    assert all(map(same_step, steps, made.steps))


@pytest.fixture(scope="module")
def sequential(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The finished log of a deployment in which 3 agents explore in turn, 40 steps each."""
    path = tmp_path_factory.mktemp("sequential") / "deployments" / "deployment_01.mcap"
    description = described("hopper-3x1", 40, 2, exploration="sequential")
    return played(path, "hopper-3x1", 120, k=1, description=description)


def unfinished(log: Path, folder: Path, stop: int | None = None) -> Path:
    """The first steps of a log, as a run that was killed leaves them."""
    path = folder / "deployments" / log.name
    writer = LogWriter.create(path, read_header(log))
    for step in read_steps(log, 0, stop):
        writer.write(step)
    writer.close()
    return path


def test_what_is_missing_at_the_end_is_told_by_every_reader(
    sequential: Path, tmp_path: Path, replay, refused, capsys: pytest.CaptureFixture[str]
) -> None:
    short = "partial: 63 of 120 steps"
    path = unfinished(sequential, tmp_path, 63)
    assert "unfinished: 63 of 120 steps; killed, or" in replay(path)[1]
    status, output = replay(path, "--recover")
    out = path.with_name("deployment_01.recovered.mcap")
    assert (status, output) == (1, f"{out}: {short}; missing: steps 63 to 119\n")
    again = tmp_path / "again.mcap"
    assert replay(out, "--recover", "--out", again)[0] == 1
    for log in (out, again):
        status, output = replay(log)
        assert f"  state         {short}\n" in output and "gaps          steps 63 to 119" in output
        status, output = replay(log, "--verify")
        assert status == 1 and f"WRONG {short} that its description asks for" in output
        assert replay(log, "--export", "csv", "--out", tmp_path / "csv", "--force")[0] == 0
        (of_log,) = json.loads((tmp_path / "csv" / "export.json").read_text())["logs"]
        assert (of_log["whole"], of_log["held"]) == (False, "63 of 120 steps")
        assert import_files([log], log.name.partition(".")[0]).notes == (f"{log.name} is {short}",)
        with pytest.raises(UserError, match=f"is {short}; the whole deployment is needed"):
            read_measured(log)
        learners = ("--publish", "--learners", "--run", tmp_path / "run")
        assert short in refused(log, *learners)
    for words in (
        ("--html", tmp_path / "page.html"),
        ("--foxglove", tmp_path / "shown.mcap"),
        ("--export", "csv", "--out", tmp_path / "again"),
    ):
        main(list(map(str, (out, *words))))
        assert f"note: {out} is {short}" in capsys.readouterr().err
    assert f"· {short}" in (tmp_path / "page.html").read_text()
    highlights(argparse.Namespace(files=[out], steps=None, episode=None, agent=None))
    assert f"note: {out} is {short}" in capsys.readouterr().err


@pytest.mark.parametrize("cut", [False, True])
def test_all_steps_of_a_log_without_its_end_are_not_called_whole(
    sequential: Path, tmp_path: Path, replay, cut: bool
) -> None:
    if cut:
        path = tmp_path / "deployment_01.mcap"
        path.write_bytes(sequential.read_bytes()[:-100])
    else:
        path = unfinished(sequential, tmp_path)
    status, output = replay(path, "--recover")
    out, count = path.with_name("deployment_01.recovered.mcap"), "120 of 120 steps"
    assert (status, output) == (0, f"{out}: recovered without its end: {count}; missing: none\n")
    replay(out, "--recover", "--out", tmp_path / "again.mcap")
    for log in (out, tmp_path / "again.mcap"):
        assert f"recovered without its end: {count}" in replay(log)[1]
        assert "-     recovered without its end" in replay(log, "--verify")[1]
        assert not read_summary(log).extent.whole


def test_what_lost_nothing_is_whole_again(sequential: Path, tmp_path: Path, replay) -> None:
    data, path = bytearray(sequential.read_bytes()), tmp_path / "log.mcap"
    data[data.index(b"otc_dist.episodes") + 60] ^= 1  # in a table, which is found again
    path.write_bytes(data)
    status, output = replay(path, "--recover")
    assert status == 0 and "all of 120 of 120 steps; missing: none" in output
    out = tmp_path / "log.recovered.mcap"
    assert "  state         recovered\n" in replay(out)[1]
    assert read_summary(out).extent.whole
    assert replay(out, "--verify")[0] == 0


def test_what_exists_is_kept_without_force(
    recorded: tuple[Recording, Path], tmp_path: Path, replay, refused
) -> None:
    path, out = damaged(recorded, tmp_path), tmp_path / "out.mcap"
    out.write_text("precious")
    assert "--force replaces it" in refused(path, "--recover", "--out", out)
    assert out.read_text() == "precious"
    replay(path, "--recover", "--out", out, "--force")
    assert read_summary(out).steps > 600


@pytest.mark.parametrize("content", [b"", b"a,b\n" * 999])
def test_nothing_to_recover_leaves_nothing(tmp_path: Path, refused, content: bytes) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    assert str(path) in refused(path, "--recover")
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]


def test_a_full_disk_leaves_nothing(
    recorded: tuple[Recording, Path], tmp_path: Path, refused
) -> None:
    path = damaged(recorded, tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        message = refused(path, "--recover")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert message == f"cannot write {tmp_path / 'log.recovered.mcap'}: File too large"
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]


def test_steps_of_another_deployment_in_a_log_of_the_older_form_are_left_out(
    sequential: Path, tmp_path: Path, replay, refused
) -> None:
    """Their checksums hold there; the seeds of their episodes do not fit."""
    mine = again(partial_path(unfinished(sequential, tmp_path / "1")), format_version=1)
    other = played(tmp_path / "other.mcap", "hopper-3x1", 120, k=2)
    theirs = again(partial_path(unfinished(other, tmp_path / "2")), format_version=1)
    data, foreign = mine.read_bytes(), theirs.read_bytes()
    start, size = _places(mine)
    there, _ = _places(theirs)
    low, high = 40 * size, 50 * size  # where whole steps begin and end, so that none is missing
    path, out = tmp_path / "log.mcap.partial", tmp_path / "out.mcap"
    path.write_bytes(
        data[: start + low] + foreign[there + low : there + high] + data[start + high :]
    )
    status, output = replay(path, "--recover", "--out", out)
    assert status == 1
    assert "missing: steps 40 to 49; left out: 10 steps with seeds of another deployment" in output
    steps = list(read_steps(sequential))
    assert all(same_step(step, steps[step.step]) for step in read_steps(out))
    assert import_files([path], "mixed").notes == (
        "log.mcap.partial is unfinished: 120 of 120 steps",
        "log.mcap.partial: log version 1, unbound to its run;"
        " left out: 10 steps with seeds of another deployment",
    )
    again(mine, deployment=2)
    message = refused(mine, "--recover", "--out", out, "--force")
    assert "no whole step; left out: 120 steps with seeds of another deployment" in message


def _places(partial: Path) -> tuple[int, int]:
    """Where the steps of an unfinished log begin, and how long each is."""
    with OpenLog(partial) as log:
        return log.first, log.layout.size
