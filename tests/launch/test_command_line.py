"""What a user types wrongly is answered by one line that helps, before anything is started."""

import subprocess
import sys
from pathlib import Path

import pytest

from otc_dist.datasets.names import DatasetName
from otc_dist.launch.__main__ import main
from otc_dist.launch.plan import descriptions, plan
from otc_dist.launch.run.resolve import resolve
from otc_dist.terminal.errors import UserError

from .short import SHORT


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["3agent_hoper"], "did you mean '3agent_hopper'?"),
        (["3agent_hopper", "--quik"], "did you mean '--quick'?"),
        (["3agent_hopper", "--seed", "one"], "'one' is not a whole number"),
        (["3agent_hopper", "--seed", "-1"], "seed"),
        (["3agent_hopper", "--set", "sampling.alfa=1"], "did you mean 'sampling.alpha'?"),
        (["3agent_hopper", "--set", "sampling.alpha"], "section.key=value"),
        (["3agent_hopper", "--set", "sampling=1"], "sampling is a section: write sampling.KEY"),
        (["3agent_hopper", "--set", "algorithm.hidden=64"], "must be a list in brackets, not 64"),
        (["3agent_hopper", "--set", "sampling.alpha=-1"], "command line: sampling.alpha"),
        (["3agent_hopper", "--set", "env.id=hopper-3x2"], "did you mean 'hopper-3x1'?"),
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
        (["navigation", "--set", "env.id=gone"], ", or module:function of your own"),
        (["navigation", "--set", "env.agents=3"], "env.agents is not for navigation"),
        (["."], "cannot read the description .: Is a directory"),
        (["missing.toml"], "cannot read the description missing.toml"),
        ([], "--list"),
        (["--resume", "nowhere"], "is not a run folder"),
        (["3agent_hopper", "--resume", "nowhere"], "leave out the description"),
        (["--resume", "nowhere", "--seed", "0"], "leave out --seed"),
        (["--resume", "nowhere", "--arm", "uniform"], "leave out --arm"),
        (["--resume", "nowhere", "--certs", "c"], "leave out --certs"),
        (["--resume", "nowhere", "--hosts", "h.toml"], "leave out --hosts"),
        (["3agent_hopper", "--list"], "--list lists what there is: leave out the description"),
        (["--list", "--dry-run"], "--list lists what there is: leave out --dry-run"),
        (["3agent_hopper", "--hosts", "h.toml", "--ssh", "--dry-run"], "leave out --dry-run"),
        (["3agent_hopper", "--hosts", "h.toml", "--from", "run"], "leave out --from"),
        (["3agent_hopper", "--seed", "0", "--seed", "1"], "--seed is given twice"),
        (["3agent_hopper", "--track", "mlflow", "--track=mlflow"], "--track is given twice"),
        (["3agent_hopper", "--seed", "0", "--set", "seed=1"], "are two seeds: leave out one"),
        (["3agent_hopper", "--view", "--prometheus", "0.0.0.0:8700"], "both want port 8700"),
        (["3agent_hopper", "--ssh"], "--ssh needs --hosts FILE"),
        (["3agent_hopper", "--deployments", "3"], "--deployments extends a run"),
        (["3agent_hopper", "--arm", "otc-embeding"], "did you mean 'otc-embedding'?"),
        (["3agent_hopper", "--arm", "perfect"], "is an arm of `launch compare` only"),
        (["3agent_hopper", "--set", "sampling.alpha=2"], "sampling.acceptance is 'share'; leave"),
        (
            ["3agent_hopper", "--arm", "uniform", "--set", "sampling.adaptive=false"],
            "sampling.adaptive has no effect: it is for sampling.acceptance = 'rank', and"
            " sampling.name is 'uniform'; leave it out",
        ),
        (["3agent_hopper", "--arm", "otc-embedding", "--set", "sampling.share=0.2"], "is 'rank'"),
        (["3agent_hopper", "--set", "offline.share=0.2"], "offline.rows is 'all'"),
        (["3agent_hopper", "--set", "offline={share=0.2}"], "offline.share has no effect"),
        (["3agent_hopper", "--set", "deployment.exploration_noise=0.3"], "exploration is 'none'"),
        (
            [
                *("3agent_hopper", "--set", "deployment.transitions=80"),
                *("--set", "deployment.fraction=0.1"),
            ],
            "deployment.fraction has no effect: it is for deployment.transitions = 0",
        ),
        *(
            (["3agent_hopper", "--from", "runs/earlier", "--set", setting], f"{key} has no effect:")
            for key, setting in (
                ("offline.updates", "offline.updates=9"),
                ("offline.rows", "offline.rows=typical"),
                ("offline.policies", "offline={policies='0123'}"),
            )
        ),
        (["3agent_hopper", "--from", "r", "--arm", "typical-offline"], "takes pi_0 from another"),
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


def test_an_engine_that_is_asked_for_and_does_not_answer_is_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("otc_dist.launch.run.resolve._ASK_ENGINE", "import signal\nsignal.pause()")
    changes = ["engine.name=auto", "bus.answer_deadline=1.0"]
    with pytest.raises(
        UserError, match="has done nothing for 1 s; try again, or choose one: --set"
    ):
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
        "100 transitions per agent",
        "agent_2/observation",
        "20,000 offline updates",
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


@pytest.mark.parametrize(
    "changes", [[], ["sampling.distance=embedding"], ["sampling.name=balanced"]]
)
def test_a_quick_look_is_at_the_same_strategy(changes: list[str]) -> None:
    whole, short = (
        descriptions.load("3agent_hopper", changes, None, quick) for quick in (False, True)
    )
    assert short.sampling.name == whole.sampling.name
    assert short.algorithm.brief == ("algorithm.improvements=1",)
    assert "improvements = 1\n" in short.to_toml() and "improvements = 50\n" in whole.to_toml()


def test_set_wins_over_quick() -> None:
    description = descriptions.load("3agent_hopper", ["offline.updates=7"], None, quick=True)
    assert description.offline.updates == 7


@pytest.mark.parametrize("size", [90, 1000, 1_000_000])
def test_a_quick_look_takes_an_imported_set_as_large_as_it_is(
    size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And deploys as few steps as ever."""
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path))
    (DatasetName("hopper-3x1", "mine").folder / str(size)).mkdir(parents=True)
    found = resolve(descriptions.load("3agent_hopper", ["dataset.name=mine"], None, quick=True))
    assert found.dataset.transitions == size
    assert found.deployment.transitions == pytest.approx(min(400, size), abs=4)
    given = ["dataset.name=mine", f"dataset.transitions={size}", "deployment.fraction=0.1"]
    found = resolve(descriptions.load("3agent_hopper", given, None, quick=True))
    assert found.deployment.transitions == pytest.approx(0.1 * size, abs=4)


@pytest.mark.slow
def test_auto_engine_is_resolved_without_torch_in_the_launcher() -> None:
    code = (
        "import sys; from otc_dist.launch.plan import descriptions\n"
        "from otc_dist.launch.run import resolve, command\n"
        "d = resolve.resolve(descriptions.load('3agent_hopper', [], None, False))\n"
        "print(d.engine.name, d.engine.products, 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    engine, products, imported = done.stdout.split()
    assert engine in {"compiled", "cuda-graph", "eager"} and products in {"own", "torch"}
    assert imported == "False"
