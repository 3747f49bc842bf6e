"""What a user types wrongly is answered by one line that helps, before anything is started."""

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
from otc_dist.description import Description
from otc_dist.launch.__main__ import main
from otc_dist.launch.compare import job_graph
from otc_dist.launch.plan import descriptions, new_folder, plan, run_record
from otc_dist.launch.plan.placement import Placement
from otc_dist.launch.run.resolve import resolve
from otc_dist.run.folder import RunFolder
from otc_dist.system.processor import kind
from otc_dist.terminal.errors import UserError
from tests.replay.played import play

SHORT = ("--set", "dataset.transitions=100", "--set", "engine.name=eager")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["3agent_hoper"], "did you mean '3agent_hopper'?"),
        (["3agent_hopper", "--quik"], "did you mean '--quick'?"),
        (["3agent_hopper", "--seed", "one"], "'one' is no whole number"),
        (["3agent_hopper", "--seed", "-1"], "seed"),
        (["3agent_hopper", "--set", "sampling.alfa=1"], "did you mean 'sampling.alpha'?"),
        (["3agent_hopper", "--set", "sampling.alpha"], "section.key=value"),
        (["3agent_hopper", "--set", "sampling=1"], "sampling is a section: write sampling.KEY"),
        (["3agent_hopper", "--set", "algorithm.hidden=64"], "must be a list in brackets, not 64"),
        (["3agent_hopper", "--set", "sampling.alpha=-1"], "command line: sampling.alpha"),
        (["3agent_hopper", "--set", "env.id=hopper-3x2"], "hopper-3x1"),
        (["3agent_hopper", "--set", "dataset.name=hopper-3x1/medum"], "hopper-3x1/medium"),
        (
            ["2agent_walker2d", "--set", "dataset.name=hopper-3x1/medium-replay"],
            "is not of the environment",
        ),
        (["3agent_hopper", "--set", "engine.name=gpu"], "engine.name"),
        (["5m_vs_6m", "--set", "algorithm.name=bcq"], "use 'discrete-cql'"),
        (["5m_vs_6m", "--set", "algorithm.name=bremen", "--set", "sampling.name=uniform"], "use"),
        (["predator_prey", "--set", "env.agents=0"], "greater than 0, not 0"),
        (["predator_prey", "--set", "env.agents=1"], "is for 2 agents or more, not 1"),
        (["navigation", "--set", "env.id=gone:parallel_env"], "there is no module gone"),
        (["navigation", "--set", "env.agents=3"], "env.agents is not for navigation"),
        (["missing.toml"], "cannot read the description missing.toml"),
        ([], "--list"),
        (["--resume", "nowhere"], "is no run folder"),
        (["3agent_hopper", "--resume", "nowhere"], "leave out the description"),
        (["--resume", "nowhere", "--seed", "0"], "leave out --seed"),
        (["--resume", "nowhere", "--arm", "uniform"], "leave out --arm"),
        (["--resume", "nowhere", "--certs", "c"], "leave out --certs"),
        (["--resume", "nowhere", "--hosts", "h.toml"], "leave out --hosts"),
        (["3agent_hopper", "--list"], "--list tells what there is: leave out the description"),
        (["--list", "--dry-run"], "--list tells what there is: leave out --dry-run"),
        (["3agent_hopper", "--hosts", "h.toml", "--ssh", "--dry-run"], "leave out --dry-run"),
        (["3agent_hopper", "--hosts", "h.toml", "--from", "run"], "leave out --from"),
        (["3agent_hopper", "--ssh"], "--ssh needs --hosts FILE"),
        (["3agent_hopper", "--deployments", "3"], "--deployments extends a run"),
        (["3agent_hopper", "--arm", "otc-embeding"], "did you mean 'otc-embedding'?"),
        (["3agent_hopper", "--arm", "perfect"], "is an arm of `launch compare` only"),
    ],
)
def test_a_mistake_is_one_line(
    arguments: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError) as caught:
        plain = {"--resume", "--list", "--hosts"} & set(arguments)
        main([*arguments[:1], *(() if plain else SHORT), *arguments[1:]])
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []  # nothing was begun


def test_a_mistyped_command_is_no_description() -> None:
    with pytest.raises(UserError, match="unknown command 'compar'; did you mean 'compare'"):
        main(["compar", "3agent_hopper"])


def test_bad_toml_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine\n')
    with pytest.raises(UserError, match=r"mine\.toml is not valid TOML"):
        main([str(path)])


def test_the_process_exits_with_2_and_no_traceback(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "otc_dist.launch", "3agent_hoper"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == (
        "error: unknown description '3agent_hoper'; did you mean '3agent_hopper'?\n"
    )


@pytest.mark.parametrize(
    ("out", "says"),
    [("file/run", "file is no folder"), ("file", "Not a directory"), ("/proc/run", "cannot make")],
)
def test_a_folder_that_cannot_be_made(out: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=says):
        new_folder.make_folder(tmp_path / out, needed=0)


def test_a_full_disk_is_noticed_before_the_start(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no disk space"):
        new_folder.make_folder(tmp_path / "run", needed=2**62)


def _tiny() -> Description:
    return descriptions.load("3agent_hopper", SHORT[1::2], None, quick=False)


def test_an_engine_that_is_asked_for_and_does_not_answer_is_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("otc_dist.launch.run.resolve._ASK_ENGINE", "import signal\nsignal.pause()")
    changes = ["engine.name=auto", "bus.answer_deadline=1.0"]
    with pytest.raises(UserError, match="has done nothing for 1 s; try again, or say it: --set"):
        resolve(descriptions.load("navigation", changes, None, True))


def test_a_user_s_environment_that_hangs_when_it_is_asked_for_its_agents_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "hangs_at_once.py").write_text("import signal\nsignal.pause()\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("otc_dist.launch.plan.plan._ASKING", 0.5)
    changes = ["env.id=hangs_at_once:make", "dataset.name=random", "bus.answer_deadline=0.5"]
    with pytest.raises(UserError, match=r"asking hangs_at_once:make for .* longer than 0.5 s"):
        plan.team_of(descriptions.load("navigation", changes, None, True))


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """A run that was begun and not finished."""
    folder = new_folder.make_folder(tmp_path / "run", needed=0)
    run_record.create(folder, resolve(_tiny()), quick=False, placement=Placement())
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
) -> None:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    words = case(monkeypatch)
    with pytest.raises(UserError) as raised:
        main([*words, *dry])
    assert said in str(raised.value)
    assert list(Path().iterdir()) == []


def test_what_took_work_is_never_taken_away(run: RunFolder) -> None:
    run.output("data").parent.mkdir()
    run.output("data").write_text("error: a mistake\n")
    for made in (run.checkpoint("agent_0", 0), run.deployment(1), run.evaluation(0)):
        made.parent.mkdir(parents=True)
        made.touch()
        assert not new_folder.take_away(run.root)
        made.unlink()
    run.checkpoint("agent_0", 0).touch()
    assert new_folder.take_away(run.root, origin=True)  # its pi_0 is another run's
    assert not run.root.exists()


def test_a_comparison_that_is_refused_before_any_job_is_done_leaves_its_name_free(
    tmp_path: Path,
) -> None:
    folder, base = ComparisonFolder(tmp_path / "compared"), resolve(_tiny())
    with pytest.raises(UserError, match="no"), job_graph.opened(folder, base):
        raise UserError("no")
    assert not folder.root.exists()
    with pytest.raises(UserError, match="no"), job_graph.opened(folder, base):
        folder.seed(0).checkpoint("agent_0", 0).parent.mkdir(parents=True)
        folder.seed(0).checkpoint("agent_0", 0).touch()
        raise UserError("no")
    assert folder.description.exists()


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
    run.description.write_text(_tiny().with_assignments("seed=9").to_toml())
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


def test_list_names_every_description(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list"]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == sorted(descriptions.shipped())
    assert {"3agent_hopper", "predator_prey", "cooperative_navigation", "navigation"} <= {*listed}


def test_a_run_takes_an_arm_of_comparisons_and_set_comes_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ("--arm", "balanced", "--dry-run", *SHORT)
    assert main(["3agent_hopper", *flags]) == 0
    out = capsys.readouterr().out
    assert "tuned by balanced sampling" in out and "runs/3agent_hopper-balanced-seed0" in out
    assert main(["3agent_hopper", *flags, "--set", "sampling.name=online-only"]) == 0
    assert "tuned by online-only sampling" in capsys.readouterr().out


def test_dry_run_prints_the_plan_and_starts_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["3agent_hopper", *SHORT, "--dry-run"]) == 0
    printed = capsys.readouterr().out
    for wanted in (
        "-m otc_dist.services.env_host --run",
        "-m otc_dist.services.learner --run",
        "--agent agent_2",
        "otc/3agent_hopper-seed0/",
        "/agent_1/observation",
        "100 transitions an agent",
        "agent_2/observation",
        "100,000 offline updates",
        "10 deployments of 4 transitions",  # 1% of 100 is 1: rounded up to the copies
    ):
        assert wanted in printed
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", sorted(descriptions.shipped()))
def test_shipped_descriptions_resolve_and_keep_their_name(name: str) -> None:
    for quick in (False, True):
        description = descriptions.load(name, ["engine.name=eager"], 3, quick)
        resolved = resolve(description)
        assert (resolved.name, resolved.seed) == (name, 3)
        assert resolved.dataset.transitions > 0
        assert resolved.deployment.transitions % resolved.env.copies == 0
        assert resolve(resolved) == resolved


def test_set_wins_over_quick() -> None:
    description = descriptions.load("3agent_hopper", ["offline.updates=7"], None, quick=True)
    assert description.offline.updates == 7


@pytest.mark.slow
def test_auto_engine_is_resolved_without_torch_in_the_launcher() -> None:
    code = (
        "import sys; from otc_dist.launch.plan import descriptions\n"
        "from otc_dist.launch.run import resolve, command\n"
        "d = resolve.resolve(descriptions.load('3agent_hopper', [], None, False))\n"
        "print(d.engine.name, 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    engine, imported = done.stdout.split()
    assert engine in {"compiled", "cuda-graph", "eager"}
    assert imported == "False"
