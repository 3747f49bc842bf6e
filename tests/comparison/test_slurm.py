"""A comparison's jobs in the queue of a real SLURM, and what is said where it refuses them."""

import json
import re
import shlex
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.description import Description
from otc_dist.launch.__main__ import main as launch
from otc_dist.launch.compare import cluster, command, held_folder, mechanism
from otc_dist.launch.plan import descriptions, run_record
from otc_dist.launch.supervise import slurm
from otc_dist.launch.supervise.jobs import Job
from otc_dist.launch.supervise.slurm import Submission
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError

from ..launch import slurm_node

_OF_ITS_OWN = ("seconds", "versions")  # what two makings of the same run may differ in


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    with slurm_node.cluster(tmp_path_factory.mktemp("slurm")) as environment:
        yield environment


@pytest.fixture
def here(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLURM_CONF", environment["SLURM_CONF"])


def jobs(folder: Path, *, first: str = "true") -> list[Job]:
    """Three, of which the second needs the first and the third the second."""
    names, made = ("first", "second", "third"), []
    for name in names:
        product = folder / f"{name} | of % 'ünï ☃'"
        work = f"echo {name} $OMP_NUM_THREADS; {first if name == 'first' else 'true'} && touch"
        work += f" {shlex.quote(str(product))}"
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
    said = capsys.readouterr().out
    assert re.search(r"0 jobs submitted; [1-8] were in the queue before", said)
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
    here: None, environment: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")  # the user's, and no job's
    stuck = jobs(tmp_path, first="sleep 1000")
    assert slurm.submit(stuck, ()) == Submission(new=3)
    assert slurm.submit(stuck, ()) == Submission(before=3)
    while slurm.queue()[stuck[0].product].state != "RUNNING" or not stuck[0].output.exists():
        pass
    queued = slurm.queue()
    assert {job.product for job in stuck} <= set(queued)
    assert "(dependency)" in dict(slurm.status(stuck))["third"].lower()
    first = queued[stuck[0].product]
    subprocess.run(["scancel", first.id], env=environment, check=True)
    wait(environment)
    assert set(slurm.queue()).isdisjoint(job.product for job in stuck)
    again = jobs(tmp_path)
    assert dict(slurm.status(again))["third"] == "not in the queue"
    made = slurm.submit(again, ("--time=1",))
    assert made.new == 3 and not made.before and not made.refused
    (told,) = made.ended
    assert told.startswith("first ended without its product; its last line: ")
    wait(environment)
    assert all(job.done for job in again)
    assert list(slurm.status(again)) == []
    assert again[1].output.read_text() == "second 1\n"


@pytest.mark.slow
def test_a_refusal_is_one_line(here: None, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="first: SLURM refuses: sbatch: error: invalid partition"):
        slurm.submit(jobs(tmp_path), slurm.options(["partition=none"]))
    flags = ["3agent_hopper", "--quick", "--out", str(tmp_path / "out"), "--on", "slurm"]
    with pytest.raises(UserError, match=r"SLURM refuses: sbatch: error: invalid partition"):
        command.main([*flags, "--slurm", "partition=none"])
    assert not (tmp_path / "out").exists()


@pytest.fixture
def say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, bytes], None]:
    """Let a command of SLURM's say that, and there is no other."""
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    (tmp_path / "bin").mkdir()

    def say(name: str, text: bytes) -> None:
        (tmp_path / "bin" / name).write_bytes(b"#!/bin/sh\necho '%b'\n" % text)
        (tmp_path / "bin" / name).chmod(0o755)

    return say


def test_jobs_of_others_and_those_that_will_not_begin_are_not_ours(
    say: Callable[[str, bytes], None], tmp_path: Path
) -> None:
    ours = jobs(tmp_path)
    products = [str(job.product).replace("'", "'\\''").encode() for job in ours]
    say(
        "squeue",
        b"1|RUNNING|None|of two\nlines\n2|PENDING|None|latin \xe9\n"
        b"3_4|RUNNING|None|%b\n5|PENDING|DependencyNeverSatisfied|%b" % tuple(products[:2]),
    )
    queued = slurm.queue()
    assert [str(queued[job.product]) for job in ours if job.product in queued] == [
        "running, SLURM's job 3_4"
    ]


def test_what_is_in_the_queue_is_neither_done_here_nor_loses_its_folder(
    say: Callable[[str, bytes], None],
    base: Description,
    tiny_flags: tuple[str, ...],
    tmp_path: Path,
) -> None:
    folder = ComparisonFolder(tmp_path / "out")
    with held_folder.opened(folder, base):  # as those that are in the queue have been submitted
        pass
    say("squeue", b"7|RUNNING|None|%b" % str(folder.run(0, "uniform")).encode())
    here = ["3agent_hopper", "--quick", "--seeds", "0", *tiny_flags, "--out", str(folder.root)]
    with pytest.raises(UserError, match="has 1 of these jobs: add --on slurm"):
        command.main(here)
    (tmp_path / "bin" / "squeue").unlink()
    with pytest.raises(UserError, match="there is no SLURM on this machine"):
        command.main([*here, "--on", "slurm"])
    assert folder.description.exists()  # which those in the queue read


@pytest.mark.parametrize("what", ["compare", "campaign", "mechanism"])
def test_what_is_refused_leaves_nothing_that_was_not_there(
    what: str,
    say: Callable[[str, bytes], None],
    finished: ComparisonFolder,
    tiny_flags: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nor policies from the cache, which took no work here; nor what would be kept elsewhere."""
    say("squeue", b"")
    (tmp_path / "bin" / "sbatch").write_text("#!/bin/sh\necho 'sbatch: error: no' >&2; exit 1\n")
    (tmp_path / "bin" / "sbatch").chmod(0o755)
    algorithm, *sizes = tiny_flags[1::2]
    monkeypatch.setattr(descriptions, "QUICK", (*descriptions.QUICK, *sizes))
    part = f'descriptions = ["3agent_hopper"]\nset = ["{algorithm}"]\n'
    (tmp_path / "two.toml").write_text(f'seeds = "0"\n[parts.one]\n{part}[parts.two]\n{part}')
    named = (
        (str(tmp_path / "two.toml"),)
        if what == "campaign"
        else ("3agent_hopper", "--set", algorithm)
    )
    kept = () if what == "mechanism" else ("--results", "kept/here")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    flags = (*("--quick", "--seeds", "0", "--on", "slurm"), *kept)
    with pytest.raises(UserError, match="SLURM refuses: sbatch: error: no"):
        launch([what, *named, *flags])
    taken = "offline policies are those that an earlier comparison trained"
    assert (taken in capsys.readouterr().out) is (what != "mechanism")
    assert list(Path().iterdir()) == []


# Takes one job, and no other.
FULL = """\
#!/bin/sh
echo "Welcome to the cluster" >&2
if [ -e '{0}' ]; then echo "sbatch: error: QOSMaxSubmitJobPerUserLimit" >&2; exit 1; fi
: >'{0}'
echo 7
"""


def test_a_queue_that_refuses_in_the_middle_is_gone_on_with(
    say: Callable[[str, bytes], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    say("squeue", b"")
    (tmp_path / "bin" / "sbatch").write_text(FULL.format(tmp_path / "full"))
    (tmp_path / "bin" / "sbatch").chmod(0o755)
    assert cluster.submit(jobs(tmp_path), ()) == 2
    said = capsys.readouterr()
    assert said.out.startswith("1 job submitted; --status shows")
    assert said.err == (
        "error: second: SLURM refuses: sbatch: error: QOSMaxSubmitJobPerUserLimit; the same command"
        " submits the rest\n"
    )


def test_an_allocation_without_nodes_is_one_line(say: Callable[[str, bytes], None]) -> None:
    say("scontrol", b"")
    with pytest.raises(UserError, match="does not say which nodes"):
        slurm.nodes()


@pytest.mark.parametrize("name", ["two\nlines", "back\\slash", "a bell \a"])
def test_a_folder_that_slurm_cannot_write_in_is_one_line(name: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="SLURM cannot take"):
        slurm.submit(jobs(tmp_path / name), ())


def test_two_do_not_submit_a_mechanism_check_at_once(finished: ComparisonFolder) -> None:
    flags = ["3agent_hopper", "--quick", "--seeds", "0", "--checkpoints", str(finished.root)]
    with (
        run_record.locked(RunFolder(finished.root)),
        pytest.raises(UserError, match="another launcher is at work"),
    ):
        mechanism.main([*flags, "--on", "slurm"])


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
        (("--on", "slurm", "--slurm", "mem=1G", "--slurm", "mem=2G"), "--slurm mem is given twice"),
        (("--on", "slurm", "--slurm", "output=x"), "output would part the jobs from what"),
        (("--on", "slurm", "--slurm", "dep=x"), "dep would part the jobs from what"),
    ],
)
def test_a_wrong_flag_is_one_line(flags: tuple[str, ...], says: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(UserError, match=says):
        command.main(["3agent_hopper", "--quick", "--out", str(out), *flags])
    assert not out.exists()
