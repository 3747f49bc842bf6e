import json
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from otc_dist.comparison import arms as arms_of
from otc_dist.comparison import collected
from otc_dist.comparison.arms import Arms
from otc_dist.comparison.scores import ComparisonFolder, Run
from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.launch.__main__ import main
from otc_dist.launch.compare import command, comparison, held_folder, job_graph, mechanism
from otc_dist.launch.plan import descriptions
from otc_dist.system.processor import processor
from otc_dist.terminal.errors import UserError


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (("--arms", "otc-embeding"), "unknown arm 'otc-embeding'; did you mean 'otc-embedding'"),
        (("--seeds", "0-9"), r"write 0\.\.9"),
        (("--seeds", "0..99999999999"), "more than 1,000 seeds at once"),
        (("--set", "evaluation.episodes=10"), "needs evaluation.episodes >= 30, not 10"),
        (("--set", "deployment.count=0"), "needs deployment.count >= 1"),
        (("--set", "ofline.updates=1"), "did you mean 'offline"),
        (("--arm", "x=evaluation.episodes=40"), "arm x: an arm may not change evaluation"),
        (("--arm", "x=seed=4"), "all arms have the seeds of --seeds; leave it out"),
        (("--arm", "x=sampling.alpha=1,sampling.alpha=2"), "sampling.alpha is given twice"),
        (("--arm", "x=sampling.alpha=1", "--arm", "x=sampling.alpha=2"), "--arm x is given twice"),
        (("--set", "seed=3"), "seeds are those of --seeds: leave out --set seed"),
        (("--set", "sampling.online_share=0.3"), "on any of the arms: each of them says it itself"),
        (
            ("--set", "sampling.alpha=2"),
            "on any of the arms: it is for sampling.acceptance = 'rank",
        ),
        (
            ("--arm", "x=sampling.name=otc,sampling.alpha=0.5"),
            "arm x: sampling.alpha has no effect: .*acceptance is 'share'",
        ),
        (("--sedes", "0"), "unknown flag '--sedes'; did you mean '--seeds'"),
    ],
)
def test_a_mistake_is_one_clear_line(flags: tuple[str, ...], expected: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(UserError, match=expected) as error:
        command.main(["3agent_hopper", "--set", "engine.name=eager", "--out", str(out), *flags])
    assert "\n" not in str(error.value)
    assert not out.exists()


@pytest.mark.parametrize("word", ["compare", "mechanism"])
def test_what_the_first_job_refuses_leaves_nothing(
    word: str,
    tiny_flags: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ("--quick", "--seeds", "0", *tiny_flags, "--set", "dataset.transitions=2")
    assert main([word, "3agent_hopper", *flags]) == 2
    assert "error: data: medium-replay data need at least" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_another_description_is_refused(base: Description, tmp_path: Path) -> None:
    folder = ComparisonFolder(tmp_path / "out")
    with held_folder.opened(folder, base):
        pass
    other = base.with_assignments("offline.updates=70")
    with (
        pytest.raises(UserError, match=r"begun with offline\.updates = 60, and this is 70"),
        held_folder.opened(folder, other),
    ):
        pass
    without = base.model_copy(update={"summary": "as shipped", "seed": 9})
    with (
        pytest.raises(UserError, match="begun with seed = 0, and this is 9"),
        held_folder.opened(folder, without),
    ):
        pass
    (tmp_path / "thesis.tex").touch()
    before = sorted(tmp_path.iterdir())
    with (
        pytest.raises(UserError, match="holds something else"),
        held_folder.opened(ComparisonFolder(tmp_path), base),
    ):
        pass
    assert sorted(tmp_path.iterdir()) == before


def test_a_comparison_does_not_go_on_with_other_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))
    base = descriptions.load(
        "3agent_hopper", ["dataset.name=random", "dataset.transitions=60"], None, quick=True
    )
    folder = ComparisonFolder(tmp_path / "compared")
    with held_folder.opened(folder, base):
        store.ensure(base.dataset.name, 60)
        held_folder.note_inputs(folder, base)  # as when the data have been made
    with held_folder.opened(folder, base):
        pass
    with store.agent_file(base.dataset.name, "agent_1", 60).open("ab") as file:
        file.write(b"other")
    with (
        pytest.raises(UserError, match=r"the data of agent_1 .* have changed since"),
        held_folder.opened(folder, base),
    ):
        pass


def test_a_finished_comparison_is_printed_again(
    finished: ComparisonFolder,
    base: Description,
    arms: Arms,
    tiny_flags: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    finished.report.unlink(missing_ok=True)
    flags = ["--arms", "otc-embedding", "--out", str(finished.root), "--quick", *tiny_flags]
    assert command.main(["3agent_hopper", "--seeds", "0,1", *flags]) == 0
    out = capsys.readouterr().out
    assert ", 0 of them to do" in out
    assert "2 complete seeds (a quick look, not a result)" in out
    assert finished.report.exists() and finished.results.exists()


def test_an_arm_with_its_own_pi_0_is_trained_and_evaluated_once_for_all_that_share_it(
    base: Description, tmp_path: Path
) -> None:
    folder = ComparisonFolder(tmp_path)
    own = ["greedy=algorithm.discount=0.5", "corrected=algorithm.discount=0.5,sampling.name=otc"]
    arms = arms_of.parse_arms("uniform", own)
    jobs = {job.name: job for job in job_graph.comparison(folder, base, arms, (0,))}
    shared, mine = jobs["seed 0, arm uniform"], jobs["seed 0, arm greedy"]
    assert jobs["seed 0, arm corrected"].needs == mine.needs
    assert set(mine.needs).isdisjoint(shared.needs) and len(mine.needs) == 4
    made = {job.product for job in jobs.values()}
    assert set(mine.needs) <= made and len(made) == len(jobs) == 1 + 2 * 4 + 4
    assert len({job.output for job in jobs.values()}) == len(jobs)
    training = jobs["seed 0, agent_1 offline for greedy"]
    assert training.command[-2:] == ("agent_1", "algorithm.discount=0.5")


def test_updates_are_compiled_once_before_all_that_would_begin_with_it(
    base: Description, tmp_path: Path
) -> None:
    folder, arms = ComparisonFolder(tmp_path), arms_of.parse_arms("uniform")
    compiling = base.with_assignments("engine.name=compiled")
    data, code, *others = job_graph.comparison(folder, compiling, arms, (0, 1))
    assert code.command[-2:] == ("compile", str(code.product)) and not code.needs
    for job in others:
        assert (code.product in job.needs) == (data.product in job.needs) == ("offline" in job.name)
    for job in others:
        if "offline" in job.name:
            job.product.parent.mkdir(parents=True)
            job.product.touch()
    left = [job for job in job_graph.comparison(folder, compiling, arms, (0, 1)) if not job.done]
    assert code.name not in [job.name for job in left]  # nothing is to be trained
    eager = job_graph.comparison(folder, base, arms, (2,))
    assert code.name not in [job.name for job in eager]


def test_tables_need_the_raw_scores_only(
    finished: ComparisonFolder,
    tiny_flags: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept = tmp_path / "tuning" / "hopper"
    flags = ["--arms", "otc-embedding", "--out", str(finished.root), "--quick", *tiny_flags]
    flags += ["--seeds", "0,1", "--results", str(kept)]
    assert command.main(["3agent_hopper", *flags]) == 0
    files = [str(path.relative_to(kept)) for path in kept.rglob("*") if path.is_file()]
    arms = ("otc-embedding", "pi_0", "uniform", "uniform-null")
    assert set(files) == {
        "description.toml",
        *(f"seed_0{seed}/{arm}.json" for seed in (0, 1) for arm in arms),
    }
    one, copy = finished.run(0, "uniform"), kept / "seed_00" / "uniform.json"
    assert Run.read(copy) == Run.read(one)  # to the bit
    assert copy.stat().st_size < 0.8 * one.stat().st_size
    shown = capsys.readouterr().out
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "no data"))
    for folder in (kept, finished.root):
        assert command.main(["--tables", str(folder)]) == 0
        out = capsys.readouterr().out
        label = f" ({descriptions.QUICK_LABEL})"
        assert out.startswith(f"3agent_hopper, hopper-3x1/medium-replay{label}; on {processor()}\n")
        tables = out.split("\n", 1)[1].strip()
        assert tables in shown  # to the letter
        words = ("minus pi_0", "minus uniform", "by t", "IQM", "worst deployed policy")
        assert all(word in tables for word in words)
    drawn = tmp_path / "returns.svg"
    assert command.main(["--tables", str(kept), "--picture", str(drawn)]) == 0
    assert capsys.readouterr().out.split("\n", 1)[1].strip() == tables
    curves = ElementTree.fromstring(drawn.read_text()).iter("{http://www.w3.org/2000/svg}path")
    assert sum(path.get("class") == "curve" for path in curves) >= 3  # an arm's each, and legends
    (kept / "seed_01" / "uniform.json").unlink()
    assert command.main(["--tables", str(kept)]) == 0
    assert "of 1 seeds" in capsys.readouterr().out


def test_a_quick_look_stays_one_whatever_was_set(
    finished: ComparisonFolder, base: Description, tmp_path: Path
) -> None:
    """As many greedy episodes as a comparison needs make no result of it."""
    folder, enough = ComparisonFolder(tmp_path / "look"), "evaluation.episodes=40"
    with held_folder.opened(folder, base.with_assignments(enough), quick=True):
        pass
    shutil.copytree(finished.root / "seeds", folder.root / "seeds")
    for path in folder.root.glob("seeds/*/*.json"):  # as if so many had been played
        scores = json.loads(path.read_text())
        for one in scores.get("evaluations", [scores]):
            for key in ("returns", "lengths"):
                one[key] = one[key] * 20
        path.write_text(json.dumps(scores))
    arms = dict.fromkeys(("uniform", "uniform-null"), ())
    looked = base.with_assignments(enough)
    kept = tmp_path / "kept"
    comparison.Comparison(folder, looked, arms, (0,), True, kept).conclude()
    assert json.loads(folder.results.read_text())["label"] == descriptions.QUICK_LABEL
    for root in (folder.root, kept):
        found = collected.collect(root)
        assert found.episodes == 40
        assert f" ({descriptions.QUICK_LABEL}); on" in next(command.lines(found))
    folder.quick.unlink()  # begun without --quick
    assert descriptions.QUICK_LABEL not in next(command.lines(collected.collect(folder.root)))


def test_scores_that_another_comparison_kept_are_not_replaced(
    finished: ComparisonFolder, base: Description, arms: Arms, tmp_path: Path
) -> None:
    kept, again = tmp_path / "kept", ComparisonFolder(tmp_path / "again")
    collected.keep(finished, arms, (0,), kept)
    collected.check(finished, kept, arms, (0, 1))  # it goes on
    again.root.mkdir()
    again.description.write_bytes(finished.description.read_bytes())
    collected.check(again, kept, arms, (1,))  # which adds to them
    for others in ("not done yet", "done anew"):
        with pytest.raises(UserError, match="would be replaced: use another --results"):
            collected.check(again, kept, arms, (0,))
        shutil.copytree(finished.root / "seeds", again.root / "seeds", dirs_exist_ok=True)
        if others == "not done yet":
            collected.check(again, kept, arms, (0,))  # they are the same
            run = again.run(0, "uniform")
            run.write_text(run.read_text().replace('"seconds": ', '"seconds": 1'))


def test_results_are_kept_apart_from_those_of_another_description(
    finished: ComparisonFolder, base: Description, arms: Arms, tmp_path: Path
) -> None:
    (tmp_path / "description.toml").write_text("name = 'another'\n")
    with pytest.raises(UserError, match="of another description; use another --results"):
        collected.keep(finished, arms, (0,), tmp_path)
    assert not (tmp_path / "seed_00").exists()


@pytest.mark.parametrize(
    ("file", "content", "expected"),
    [
        ("description.toml", None, "is not the folder of a comparison"),
        ("description.toml", "name = ", "description.toml is damaged"),
        ("description.toml", "name = 'x'\n[env]\n", "description.toml is damaged"),
        ("seed_00/uniform.json", None, "holds no run of uniform"),
        ("seed_00/uniform.json", "{}", r"uniform\.json has format"),
        ("seed_00/uniform.json", '{"format": 2}', r"uniform\.json is damaged"),
        ("seed_00/uniform.json", "{", r"cannot read .*uniform\.json"),
        ("seed_00/uniform-null.json", "copy", "is of uniform, seed 0"),
    ],
)
def test_a_damaged_folder_of_scores_is_one_clear_line(
    finished: ComparisonFolder, tmp_path: Path, file: str, content: str | None, expected: str
) -> None:
    collected.keep(finished, ("uniform",), (0,), tmp_path)
    path = tmp_path / file
    if content is None:
        path.unlink()
    else:
        uniform = (tmp_path / "seed_00" / "uniform.json").read_text()
        path.write_text(uniform if content == "copy" else content)
    with pytest.raises(UserError, match=expected) as error:
        command.main(["--tables", str(tmp_path)])
    assert "\n" not in str(error.value)


def test_the_folder_of_a_run_is_none_of_a_comparison(base: Description, tmp_path: Path) -> None:
    (tmp_path / "description.toml").write_text(base.to_toml())
    (tmp_path / "run.json").write_text("{}")
    before = sorted(tmp_path.iterdir())
    for words in (["--tables"], ["3agent_hopper", "--quick", "--out"]):
        with pytest.raises(UserError, match="is the folder of a run, not of a comparison"):
            command.main([*words, str(tmp_path)])
    assert sorted(tmp_path.iterdir()) == before


def test_tables_run_nothing_and_so_take_no_other_flag(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="leave out --seeds"):
        command.main(["--tables", str(tmp_path), "--seeds", "0"])
    with pytest.raises(UserError, match="leave out the description"):
        command.main(["3agent_hopper", "--tables", str(tmp_path)])
    with pytest.raises(UserError, match="--picture draws what --tables shows: give both"):
        command.main(["3agent_hopper", "--picture", str(tmp_path / "a.svg")])
    with pytest.raises(UserError, match=r"--picture writes \.svg, and a\.png ends differently"):
        command.main(["--tables", str(tmp_path), "--picture", "a.png"])
    with pytest.raises(UserError, match="compare which description"):
        command.main([])


def test_the_mechanism_takes_the_offline_policies_of_a_comparison_as_they_are(
    finished: ComparisonFolder,
) -> None:
    with pytest.raises(UserError, match="would change pi_0"):
        mechanism.main(
            ["3agent_hopper", "--checkpoints", str(finished.root), "--set", "offline.updates=61"]
        )
    with pytest.raises(UserError, match="is of 3agent_hopper, not of 2agent_walker2d"):
        mechanism.main(["2agent_walker2d", "--checkpoints", str(finished.root)])


def test_the_mechanism_needs_other_agents(base: Description, tmp_path: Path) -> None:
    alone = base.with_assignments("env.id=hopper-1x3", "dataset.name=medium-replay")
    folder = ComparisonFolder(tmp_path)
    folder.description.write_text(alone.to_toml())
    with pytest.raises(UserError, match="about other agents, and hopper-1x3 has none"):
        mechanism.main(["3agent_hopper", "--checkpoints", str(tmp_path)])


@pytest.mark.slow
def test_from_nothing_to_the_report_and_the_mechanism(
    tmp_path: Path, tiny_flags: tuple[str, ...]
) -> None:
    def launch(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "otc_dist.launch", *arguments, *tiny_flags],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    command = ("compare", "3agent_hopper", "--quick", "--arms", "otc-value", "--seeds", "0")
    out = launch(*command)
    assert "seed 0, arm otc-value: done" in out and "1 complete seed" in out
    folder = ComparisonFolder(tmp_path / "runs" / "compare-3agent_hopper-quick")
    assert json.loads(folder.results.read_text())["seeds"] == [0]
    before = folder.run(0, "otc-value").read_bytes()
    again = launch(*command)
    assert "0 of them to do" in again and folder.run(0, "otc-value").read_bytes() == before
    found = launch("mechanism", "3agent_hopper", "--quick", "--seeds", "0")
    assert "oracle: the mismatch itself" in found
