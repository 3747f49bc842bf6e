"""When a run may have its folder: a new one that is free, or its own that it left."""

import fcntl
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.datasets import store
from otc_dist.datasets.importers import import_files
from otc_dist.launch.__main__ import main
from otc_dist.launch.compare import held_folder
from otc_dist.launch.plan import new_folder, run_record
from otc_dist.launch.plan.new_folder import NewFolder
from otc_dist.launch.plan.placement import Placement
from otc_dist.launch.run.resolve import resolve
from otc_dist.run.folder import RunFolder
from otc_dist.system.processor import kind
from otc_dist.terminal.errors import UserError
from tests.replay.played import play

from .short import SHORT, short_description


@pytest.mark.parametrize(
    ("out", "says"),
    [
        ("file/run", "file is not a folder"),
        ("file", "Not a directory"),
        ("/proc/run", "cannot make"),
    ],
)
def test_a_folder_that_cannot_be_made(out: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=says):
        new_folder.make_folder(tmp_path / out, needed=0)


def test_a_full_disk_is_noticed_before_the_start(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no disk space"):
        new_folder.make_folder(tmp_path / "run", needed=2**62)


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """A run that was begun and not finished."""
    folder = RunFolder(new_folder.make_folder(tmp_path / "run", needed=0).root)
    run_record.create(folder, resolve(short_description()), quick=False, placement=Placement())
    return folder


@pytest.mark.parametrize("dry", [[], ["--dry-run"]])
def test_an_existing_run_is_not_overwritten(run: RunFolder, dry: list[str]) -> None:
    with pytest.raises(UserError, match=r"exists already; use --resume .*, or another --out"):
        main(["3agent_hopper", *SHORT, "--out", str(run.root), *dry])


def _too_few(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    return ["3agent_hopper", *SHORT, "--set", "dataset.transitions=2"]


def _damaged(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    log = Path("a.mcap")
    play("hopper-3x1", log, 20, run="mine")
    card = import_files([log])
    path = store.agent_file(card.name, "agent_1")
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    log.unlink()
    return ["3agent_hopper", "--set", f"dataset.name={card.name}", *SHORT[2:]]


def _full(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    full = os.statvfs_result((4096, 4096, 10, 0, 0, 0, 0, 0, 0, 255))
    monkeypatch.setattr("os.statvfs", lambda path: full)
    return ["3agent_hopper", *SHORT]


def _no_right(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setattr("os.access", lambda path, mode: False)
    return ["3agent_hopper", *SHORT]


@pytest.mark.parametrize("dry", [[], ["--dry-run"]])
@pytest.mark.parametrize(
    ("case", "said"),
    [
        (_too_few, "medium-replay data need at least"),
        (_damaged, "agent_1.safetensors does not match its sha256"),
        (_full, "no disk space at runs/3agent_hopper-seed0"),
        (_no_right, "permission denied"),
    ],
)
def test_a_dry_run_checks_what_a_start_checks_and_neither_leaves_anything(
    case: Callable[[pytest.MonkeyPatch], list[str]],
    said: str,
    dry: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    words = case(monkeypatch)
    with pytest.raises(UserError) as raised:
        main([*words, *dry])
    assert said in str(raised.value)
    assert capsys.readouterr().out == ""  # no plan of what cannot be done
    assert list(Path().iterdir()) == []


def test_what_took_work_is_never_taken_away(tmp_path: Path) -> None:
    new = NewFolder(tmp_path / "run")
    run = RunFolder(new.root)
    run.output("data").parent.mkdir()
    run.output("data").write_text("error: a mistake\n")
    for made in (run.checkpoint("agent_0", 0), run.deployment(1), run.evaluation(0)):
        made.parent.mkdir(parents=True)
        made.touch()
        assert not new.take_away()
        made.unlink()
    run.checkpoint("agent_0", 0).touch()
    new.given.add(run.checkpoint("agent_0", 0))  # its pi_0 is another run's
    assert new.take_away() and new.take_away()
    assert not run.root.exists()


@pytest.mark.parametrize("theirs", ["seed_00/uniform.json", "notes.txt", "run.json"])
def test_what_was_there_before_is_never_taken_away(theirs: str, tmp_path: Path) -> None:
    """Whatever the folder is; but what a launcher has left that was killed as it began is."""
    (tmp_path / "run" / "output").mkdir(parents=True)
    for name in (".lock", "description.toml", "inputs.json.partial", "output/data.log"):
        (tmp_path / "run" / name).touch()
    assert NewFolder(tmp_path / "run").take_away()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "run" / theirs).parent.mkdir(parents=True)
    (tmp_path / "run" / theirs).touch()
    assert not NewFolder(tmp_path / "run").take_away()
    assert (tmp_path / "run" / theirs).exists()


def test_what_was_made_above_a_folder_goes_with_it_and_nothing_else(tmp_path: Path) -> None:
    first, second = (NewFolder(tmp_path / "runs/all" / name) for name in ("first", "second"))
    for new, left in ((first, ["runs"]), (second, ["runs"])):
        assert new.take_away()
        assert [path.name for path in tmp_path.iterdir()] == left
    first = NewFolder(tmp_path / "more/all/first")
    second = NewFolder(tmp_path / "more/all/second")
    (tmp_path / "runs" / "all").rmdir()
    (tmp_path / "runs").rmdir()
    assert second.take_away() and first.take_away()
    assert list(tmp_path.iterdir()) == []


def test_a_comparison_that_is_refused_before_any_job_is_done_leaves_its_name_free(
    tmp_path: Path,
) -> None:
    folder, base = ComparisonFolder(tmp_path / "compared"), resolve(short_description())
    with pytest.raises(UserError, match="no"), held_folder.opened(folder, base):
        raise UserError("no")
    assert not folder.root.exists()
    with pytest.raises(UserError, match="no"), held_folder.opened(folder, base):
        folder.seed(0).checkpoint("agent_0", 0).parent.mkdir(parents=True)
        folder.seed(0).checkpoint("agent_0", 0).touch()
        raise UserError("no")
    assert folder.description.exists()


def test_kept_raw_scores_are_no_folder_to_compare_in(tmp_path: Path) -> None:
    folder, base = ComparisonFolder(tmp_path), resolve(short_description())
    folder.description.write_text(base.to_toml())
    (tmp_path / "seed_00").mkdir()
    (tmp_path / "seed_00" / "uniform.json").touch()
    before = sorted(tmp_path.rglob("*"))
    with (
        pytest.raises(UserError, match="holds kept raw scores; use another --out"),
        held_folder.opened(folder, base),
    ):
        pass
    assert sorted(tmp_path.rglob("*")) == before


def test_a_run_that_was_killed_before_it_began_is_begun_again(
    run: RunFolder, tmp_path: Path
) -> None:
    """But a folder of the user's own, with a file of such a name in it, is left alone."""
    (run.root / ".lock").touch()
    run.run_json.unlink()
    new_folder.make_folder(run.root, needed=0)
    (run.root / ".lock").unlink()
    with pytest.raises(UserError, match="exists already; use another --out"):
        new_folder.make_folder(run.root, needed=0)


def test_a_changed_description_is_not_resumed(run: RunFolder) -> None:
    run.description.write_text(short_description().with_assignments("seed=9").to_toml())
    with pytest.raises(UserError, match="has changed since the run began"):
        main(["--resume", str(run.root)])


def test_other_versions_do_not_resume(run: RunFolder) -> None:
    record = json.loads(run.run_json.read_text())
    record["versions"]["torch"] = "1.0"
    run.run_json.write_text(json.dumps(record))
    with pytest.raises(UserError, match=r"begun with torch 1\.0"):
        main(["--resume", str(run.root)])


def test_another_kind_of_processor_is_said_once_and_the_run_goes_on(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    record = json.loads(run.run_json.read_text())
    assert record["processors"] == [kind()]
    run.run_json.write_text(json.dumps({**record, "processors": ["Another 7 (avx2)"]}))
    capsys.readouterr()
    reopened, _ = run_record.reopen(run)
    assert reopened.processors == ("Another 7 (avx2)", kind())
    (line,) = capsys.readouterr().out.splitlines()
    assert "ran on Another 7 (avx2), and this is" in line and "as they are" in line
    run_record.reopen(run)
    assert capsys.readouterr().out == ""


def test_what_the_system_refuses_the_launcher_is_one_line(run: RunFolder) -> None:
    run.root.joinpath("output").touch()  # where a folder is to be
    with pytest.raises(UserError, match=r"run/output: File exists; resume with: python"):
        main(["--resume", str(run.root)])
    assert run_record.RunRecord.read(run).state == "failed"
    run.description.chmod(0o000)
    # A process of its own: a command that ends while a session closes takes its process along.
    command = [sys.executable, "-m", "otc_dist.launch", "--resume", run.root / "description.toml"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: ") and len(ended.stderr.splitlines()) == 1


def test_a_damaged_record_is_one_line(run: RunFolder) -> None:
    run.run_json.write_text("{")
    with pytest.raises(UserError, match=r"run\.json is damaged"):
        main(["--resume", str(run.root)])


def test_two_launchers_do_not_share_a_run(run: RunFolder) -> None:
    handle = os.open(run.root / ".lock", os.O_RDWR | os.O_CREAT)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        with pytest.raises(UserError, match="another launcher is at work"):
            main(["--resume", str(run.root)])
    finally:
        os.close(handle)
