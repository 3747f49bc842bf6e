"""A comparison's jobs in the queue of a real SLURM, and what is said where it refuses them."""

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.launch.compare import command
from otc_dist.launch.supervise import slurm
from otc_dist.launch.supervise.jobs import Job
from otc_dist.terminal.errors import UserError

from ..launch.slurm_node import cluster

_OF_ITS_OWN = ("seconds", "versions")  # what two makings of the same run may differ in


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    with cluster(tmp_path_factory.mktemp("slurm")) as environment:
        yield environment


@pytest.fixture
def here(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLURM_CONF", environment["SLURM_CONF"])


def jobs(folder: Path, *, first: str = "true") -> list[Job]:
    """Three, of which the second needs the first and the third the second."""
    names, made = ("first", "second", "third"), []
    for name in names:
        product = folder / f"{name} | of % all"
        work = f"echo {name}; {first if name == 'first' else 'true'} && touch '{product}'"
        needs = (made[-1].product,) if made else ()
        made.append(Job(name, ("sh", "-c", work), product, folder / "out %j" / name, needs))
    return made


def wait(environment: dict[str, str]) -> None:
    """Until all that is queued now has ended, well or not."""
    listed = subprocess.run(
        ["squeue", "--noheader", "--format=%i"], env=environment, capture_output=True, text=True
    )
    if ids := listed.stdout.split():
        after = f"--dependency=afterany:{':'.join(ids)}"
        subprocess.run(["srun", "--quiet", after, "true"], env=environment, check=True, timeout=300)


@pytest.mark.slow
def test_results_are_those_of_this_machine(
    here: None,
    environment: dict[str, str],
    finished: ComparisonFolder,
    tiny_flags: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))  # nothing is there yet
    out = tmp_path / "by slurm"
    flags = ["--arms", "otc-embedding", "--seeds", "0", "--out", str(out), "--quick", *tiny_flags]
    queued = ["3agent_hopper", *flags, "--on", "slurm", "--slurm", "time=0:30:00"]
    assert command.main(queued) == 0
    said = capsys.readouterr().out
    assert "8 jobs submitted; --status shows them" in said and "no seed is complete" in said
    assert command.main(queued) == 0
    assert "0 jobs submitted; 8 were in the queue before" in capsys.readouterr().out
    assert command.main([*queued, "--status"]) == 0
    assert "of 8 jobs are done" in capsys.readouterr().out
    wait(environment)
    assert command.main(queued) == 0
    assert "8 jobs, 0 of them to do" in (said := capsys.readouterr().out)
    assert "1 complete seed (a quick look, not a result)" in said
    theirs, ours = ComparisonFolder(out), finished
    for arm in ("uniform", "uniform-null", "otc-embedding"):
        there, local = (json.loads(f.run(0, arm).read_text()) for f in (theirs, ours))
        assert there | dict.fromkeys(_OF_ITS_OWN) == local | dict.fromkeys(_OF_ITS_OWN)
    for agent in ("agent_0", "agent_1", "agent_2"):
        place = Path("agents") / agent / "checkpoint_00.safetensors"
        there, local = (f.seed(0).root / place for f in (theirs, ours))
        assert there.read_bytes() == local.read_bytes()


@pytest.mark.slow
def test_what_was_ended_before_its_time_is_submitted_again(
    here: None, environment: dict[str, str], tmp_path: Path
) -> None:
    stuck = jobs(tmp_path, first="sleep 1000")
    assert slurm.submit(stuck, ()) == (3, "")
    assert slurm.submit(stuck, ()) == (0, "")
    queued = slurm.queue()
    assert {job.product for job in stuck} <= set(queued)
    assert "(dependency)" in dict(slurm.status(stuck))["third"].lower()
    first = queued[stuck[0].product]
    subprocess.run(["scancel", first.id], env=environment, check=True)
    wait(environment)
    assert set(slurm.queue()).isdisjoint(job.product for job in stuck)
    again = jobs(tmp_path)
    assert dict(slurm.status(again))["third"] == "not in the queue"
    assert slurm.submit(again, ("--time=1",)) == (3, "")
    wait(environment)
    assert all(job.done for job in again)
    assert list(slurm.status(again)) == []
    assert again[1].output.read_text() == "second\n"


@pytest.mark.slow
def test_a_refusal_is_one_line(here: None, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="first: SLURM refuses: sbatch: error: invalid partition"):
        slurm.submit(jobs(tmp_path), slurm.options(["partition=none"]))
    flags = ["3agent_hopper", "--quick", "--out", str(tmp_path / "out"), "--on", "slurm"]
    with pytest.raises(UserError, match="data: SLURM refuses"):
        command.main([*flags, "--slurm", "partition=none"])
    assert not (tmp_path / "out").exists()


def test_without_slurm_one_line_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match="there is no SLURM on this machine: squeue is not found"):
        slurm.submit(jobs(tmp_path), ())


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--slurm", "time=1"), "--slurm needs --on slurm"),
        (("--status",), "--status needs --on slurm"),
        (("--on", "slurm", "--slurm", "time"), "write key=value"),
        (("--on", "slurm", "--slurm=--wrap=x"), "write key=value"),
        (("--on", "slurm", "--slurm", "output=x"), "output is set for every job"),
    ],
)
def test_a_wrong_flag_is_one_line(flags: tuple[str, ...], says: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(UserError, match=says):
        command.main(["3agent_hopper", "--quick", "--out", str(out), *flags])
    assert not out.exists()
