"""Several comparisons that one file lists: their jobs, their results, and mistakes."""

import json
import re
import shutil
from pathlib import Path

import pytest

from otc_dist.comparison import arms as arms_of
from otc_dist.comparison import spent
from otc_dist.comparison.arms import describe
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.comparison.spent import Spent
from otc_dist.launch.__main__ import main
from otc_dist.launch.compare import campaign_file, comparison, rates
from otc_dist.launch.compare.campaign_file import Campaign, Prepared
from otc_dist.launch.compare.comparison import Comparison
from otc_dist.launch.plan import descriptions
from otc_dist.system.processor import processor
from otc_dist.terminal.errors import UserError

PARTS = ("3agent_hopper-medium-replay-one", "3agent_hopper-medium-replay-two")
_OF_ITS_OWN = ("seconds", "versions")  # what two makings of the same run may differ in


@pytest.fixture
def file(tmp_path: Path, tiny_flags: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> Path:
    """A campaign of two comparisons that are, by `--quick`, those of the fixture `finished`."""
    algorithm, *sizes = tiny_flags[1::2]
    quick = (*descriptions.QUICK, *sizes)
    monkeypatch.setattr("otc_dist.launch.plan.descriptions.QUICK", quick)
    path = tmp_path / "twice.toml"
    part = 'descriptions = ["3agent_hopper"]\narms = ["otc-embedding"]\n'
    # The size is not for a quick look.
    part += f'set = ["{algorithm}", "sampling.name=otc", "offline.updates=1"]\n'
    figure = 'title = "Figure"\nclaim = "two comparisons agree"\nparts = ["one"]\nalpha = true\n'
    figure += 'better = ["otc-embedding"]\nthan = ["uniform"]\n'
    path.write_text(f'seeds = "0..1"\n[[figures]]\n{figure}[parts.one]\n{part}[parts.two]\n{part}')
    return path


@pytest.fixture
def out(tmp_path: Path, finished: ComparisonFolder) -> Path:
    """Its folder, in which one run of each part is still to be done."""
    for seed, part in enumerate(PARTS):
        shutil.copytree(finished.root, tmp_path / "out" / part)
        ComparisonFolder(tmp_path / "out" / part).run(seed, "uniform-null").unlink()
    return tmp_path / "out"


def compared(file: Path, root: Path, seeds: tuple[int, ...]) -> list[Comparison]:
    return [
        Comparison(
            ComparisonFolder(root / one.name), one.base, one.arms, seeds, True, None, one.name
        )
        for one in Campaign.load(file).comparisons(quick=True)
    ]


def launch(*words: str | Path) -> int:
    return main(["campaign", *map(str, words)])


@pytest.mark.slow
def test_a_campaign_is_gone_on_with_and_each_part_s_scores_are_those_of_its_comparison(
    file: Path, out: Path, finished: ComparisonFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = out.parent / "kept"
    command = (file, "--quick", "--out", out, "--results", kept)
    assert launch(*command) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"{out}: 29 jobs, 2 of them to do\n")
    assert said.count(": done in ") == 2
    assert f"{PARTS[0]}: 2 complete seeds (a quick look, not a result); report: {out}" in said
    for seed, part in enumerate(PARTS):
        mine = ComparisonFolder(out / part)
        assert mine.report.exists()
        again, before = (
            json.loads(folder.run(seed, "uniform-null").read_text()) for folder in (mine, finished)
        )
        assert again | dict.fromkeys(_OF_ITS_OWN) == before | dict.fromkeys(_OF_ITS_OWN)
        spent = kept / part / f"seed_0{seed}" / "spent.json"
        (job,) = json.loads(spent.read_text()).items()  # the one that was a process of its own
        assert job[0] == "uniform-null" and job[1]["processor_seconds"] > 0.5
        assert job[1]["processor"] == again["processor"]
        assert len({*(kept / part).glob("seed_0[01]/*.json")} - {spent}) == 2 * 4
        assert (kept / file.name).read_bytes() == (out / file.name).read_bytes()
    page = (out / "campaign.html").read_text()
    assert said.endswith(f"all together: {out / 'campaign.html'}\n")
    assert "two comparisons agree" in page and "2 seeds" in page
    assert launch("--tables", kept, "--page", out.parent / "again.html") == 0
    shown = capsys.readouterr().out
    assert "one: gain, last, minus uniform" in shown and "two: gain, recommended" in shown
    assert "here: Undecided: otc-embedding minus uniform" in shown
    assert (out.parent / "again.html").read_text() == page.replace(
        "Campaign: out", "Campaign: kept"
    )
    assert launch(*command) == 0
    assert ", 0 of them to do\n" in (said := capsys.readouterr().out)
    assert all(f"{part}: 2 complete seeds" in said for part in PARTS)


def test_tables_are_those_of_every_comparison_and_need_the_raw_scores_only(
    out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ComparisonFolder(out / PARTS[1]).run(0, "uniform").unlink()
    ComparisonFolder(out / PARTS[1]).run(1, "uniform").unlink()
    assert main(["compare", "--tables", str(out / PARTS[0])]) == 0
    tables = capsys.readouterr().out
    assert launch("--tables", out) == 0
    expected = f"{PARTS[0]}:\n{tables}\n{PARTS[1]}: no seed is complete yet\n\nall together:\n"
    assert capsys.readouterr().out.startswith(expected)
    with pytest.raises(UserError, match="not the folder of a campaign"):
        launch("--tables", out / PARTS[0])


def test_seeds_come_before_parts_and_what_parts_share_is_made_once(
    file: Path, tmp_path: Path
) -> None:
    jobs = comparison.jobs_of(compared(file, tmp_path, (0, 1)))
    assert len(jobs) == len({job.product for job in jobs}) == len({job.name for job in jobs})
    assert len(jobs) == 1 + 2 * 2 * 7  # the data, and a seed's jobs
    seeds = [job.name.split(", ")[1] for job in jobs[1:]]
    assert seeds == sorted(seeds) and {job.name.split(", ")[0] for job in jobs[:15]} == {*PARTS}


def test_a_dry_run_says_what_is_left_and_for_how_long(
    file: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(out.rglob("*"))
    assert launch(file, "--quick", "--out", out, "--seeds", "0..2", "--dry-run") == 0
    seeds, _, one, two, whole, how, *hours = capsys.readouterr().out.splitlines()
    assert seeds.startswith("seeds 0, 1, 2:")
    # The data were made before, and lie in none of the folders.
    assert [line.split()[:4] for line in (one, two)] == [
        [PARTS[0], "22", "0.0", "8"],
        [PARTS[1], "21", "0.0", "8"],
    ]
    assert whole.split()[:5] == ["in", "all", "43", "0.0", "16"]
    assert how.startswith("by rates of another machine: no job that is done says what it took")
    assert all(
        re.fullmatch(r"about .* (s|min) on (this machine|a cluster), \d+ cores?", x) for x in hours
    )
    assert sorted(out.rglob("*")) == before


def test_what_is_left_takes_as_long_as_its_kind_did(
    file: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each job by those that do the same for another seed, by any of its piece, or by all."""
    comparisons = compared(file, out, (0, 1, 2))
    jobs = comparison.jobs_of(comparisons)
    assert rates.measured(comparisons, jobs, rates.read(jobs)) == jobs
    said = {
        out / PARTS[part] / "output" / f"{output}.log": times
        for part, output, times in (
            (0, "seed_00_uniform", 3.0),
            (0, "seed_01_uniform", 5.0),  # the same job: by both
            (0, "seed_00_offline_agent_0", 2.0),
            (1, "seed_00_otc-embedding", 8.0),
            (1, "seed_01_uniform-null", 100.0),  # it is not done
        )
    }
    by_output = {job.output: job for job in jobs}
    for path, times in said.items():
        Spent(times * by_output[path].seconds, processor()).write(spent.beside(path))
    path = out / PARTS[0] / "output" / "seed_01_pi_0.log"
    Spent(1e6, "of another kind").write(spent.beside(path))

    found = zip(jobs, rates.measured(comparisons, jobs, rates.read(jobs)), strict=True)
    slower = {job.output: now.seconds / job.seconds for job, now in found}

    def told(part: int, job: str) -> float:
        return slower[out / PARTS[part] / "output" / f"seed_02_{job}.log"]

    assert told(0, "uniform") == pytest.approx(4.0) == told(1, "uniform")
    assert told(0, "otc-embedding") == pytest.approx(8.0) == told(1, "otc-embedding")
    assert told(1, "offline_agent_2") == pytest.approx(2.0)
    done = [(by_output[path], times) for path, times in said.items() if by_output[path].done]
    took = sum(job.seconds * times for job, times in done)
    of_all = took / sum(job.seconds for job, _ in done)
    assert told(0, "pi_0") == pytest.approx(of_all) == told(1, "uniform-null")

    assert launch(file, "--quick", "--out", out, "--seeds", "0..2", "--dry-run") == 0
    assert "by the processor time that jobs took which are done\n" in capsys.readouterr().out
    spent.beside(path).write_text("{}")
    with pytest.raises(UserError, match=r"seed_01_pi_0\.json is damaged: .*; delete it"):
        launch(file, "--quick", "--out", out, "--dry-run")


def test_on_a_cluster_the_jobs_of_all_parts_go_into_the_queue(
    file: Path, out: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (bin_ := out.parent / "bin").mkdir()
    for name, does in {"squeue": "", "sbatch": f"echo \"$*\" >>'{bin_}/asked'; echo 7"}.items():
        (bin_ / name).write_text(f"#!/bin/sh\n{does}\n")
        (bin_ / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(bin_))
    assert launch(file, "--quick", "--out", out, "--on", "slurm", "--slurm", "time=9") == 0
    said = capsys.readouterr().out
    assert "2 jobs submitted" in said
    assert all(f"{part}: 1 complete seed of 2: so far" in said for part in PARTS)
    asked = (bin_ / "asked").read_text().splitlines()
    for seed, (part, line) in enumerate(zip(PARTS, asked, strict=True)):
        assert f"--job-name={part}, seed {seed}, arm uniform-null" in line and "--time=9" in line


def test_the_paper_s_first_table() -> None:
    campaign = Campaign.load(campaign_file.find("paper-table1"))
    found = {one.name: one for one in campaign.comparisons(quick=True)}
    assert campaign.seeds == "20..24" and len(found) == 3 * 3 * 3
    paper = {"paper-embedding", "paper-value"}
    figures = {"paper-embedding-fixed", "balanced", "online-only"}  # 4 and 5
    arms = {"bcq": paper | figures, "awac": paper, "default": {"rlpd"}}
    for robot in ("2agent_halfcheetah", "2agent_walker2d", "3agent_hopper"):
        shipped = descriptions.load(robot, (), None, quick=False).algorithm.name
        algorithm_of = {"bcq": "bcq", "awac": "awac", "default": shipped}
        for level in ("random", "medium", "medium-replay"):
            for key, algorithm in algorithm_of.items():
                one = found[f"{robot}-{level}-{key}"]
                assert one.base.dataset.name == f"{one.base.env.id}/{level}"
                assert one.base.algorithm.name == algorithm
                assert one.base.offline.updates == 500  # as in any quick look
                assert set(one.arms) == {*arms[key], "uniform", "uniform-null"}
                if key == "default":  # an arm is the description as it stands
                    described = [describe(one.base, arm, 0) for arm in one.arms.values()]
                    assert one.base.with_assignments("seed=0") in described


def test_the_paper_s_figures_are_of_its_tasks_algorithms_and_numbers_of_agents() -> None:
    def comparisons(name: str) -> dict[str, Prepared]:
        campaign = Campaign.load(campaign_file.find(name))
        return {one.name: one for one in campaign.comparisons(quick=True)}

    expected = {
        "paper-figure6ab": {
            "predator_prey-random-figure6a": ("predator-prey-3", "bremen"),
            "cooperative_navigation-random-figure6b": ("cooperative-navigation-4", "bremen"),
        },
        "paper-figure6c": {"navigation-random-figure6c": ("navigation", "bcq")},
        "paper-figure6d": {"5m_vs_6m-medium-figure6d": ("5m_vs_6m", "discrete-cql")},
        "paper-figures7-8": {
            f"cooperative_navigation-{agents}-random-figure{8 if agents in (4, 6) else 7}": (
                f"cooperative-navigation-{agents}",
                "td3bc",
            )
            for agents in range(2, 9)
        },
    }
    found = {name: comparisons(name) for name in expected}
    assert {
        name: {key: (one.base.env.id, one.base.algorithm.name) for key, one in of.items()}
        for name, of in found.items()
    } == expected
    (skirmish,) = found["paper-figure6d"].values()
    assert skirmish.base.deployment.exploration == "sequential"
    fixed = found["paper-figures7-8"]["cooperative_navigation-6-random-figure8"]
    one = arms_of.describe(fixed.base, fixed.arms["paper-value-fixed"], 0).sampling
    other = arms_of.describe(fixed.base, fixed.arms["paper-value"], 0).sampling
    assert one.model_dump() == other.model_dump() | {"adaptive": False}


@pytest.mark.parametrize(
    ("change", "flags", "expected"),
    [
        (None, ("paper-tabel1",), "unknown campaign 'paper-tabel1'; did you mean 'paper-table1'"),
        (None, ("gone.toml",), "cannot read the campaign gone.toml: No such file"),
        (None, (), r"which campaign\? .* comes with the package: paper-figure6ab, "),
        (None, ("--tables", "a", "--seeds", "0"), "leave out --seeds"),
        (None, ("--tables", "a", "--page", "b.pdf"), r"--page writes \.html, and b\.pdf ends"),
        (None, ("a", "--page", "b.html"), "--page is made of what --tables shows: give both"),
        (None, ("a", "--dry-run", "--results", "b"), "leave out --results"),
        (None, ("a", "--status"), "--status needs --on slurm"),
        ('seeds = "', (), r"twice\.toml is not valid TOML"),
        ("[parts.one]", (), r"twice\.toml is not valid TOML: .*declare"),
        ("sedes = 1", (), r"twice\.toml: unknown key 'sedes'; did you mean 'seeds'"),
        ("[parts.x]\ndescriptions = []", (), r"twice\.toml: parts\.x\.descriptions: "),
        ("[parts.x]", (), r"parts\.x\.descriptions is missing: it has no default"),
        ("[published]\nsource = 'x'", (), r"twice\.toml: published\.parts is missing"),
        ("[published]\nsource = 'x'\nparts.one.x.uniform = [1]", (), r"published\.parts\.one"),
        ("[[figures]]\ntitle = 'x'", (), r"twice\.toml: figures.* is missing"),
        ("arm = 'mine'", (), r"parts\.two\.arm must be a list in brackets, not 'mine'"),
        ("datsets = []", (), r"unknown key 'parts\.two\.datsets'; did you mean .*datasets"),
        ("datasets = ['medum']", (), r"twice\.toml: parts\.two: .*hopper-3x1/medum"),
        ("[parts.x]\ndescriptions = ['3agent_hoper']", (), r"parts\.x: .* mean '3agent_hopper'"),
        ("arm = ['x=sampling.nam=otc']", (), r"parts\.two: arm x: .* mean 'sampling\.name'"),
        (
            "[parts.x]\ndescriptions = ['3agent_hopper']\nset = ['seed=3']",
            (),
            r"parts\.x: a comparison's seeds are those of --seeds",
        ),
        ("agents = [2]", (), r"twice\.toml: parts\.two: .*env\.agents is not for hopper-3x1"),
        ("agents = [0]", (), r"parts\.two\.agents"),
        ("agents = 2", (), r"parts\.two\.agents must be a list in brackets, not 2"),
        ("datasets = ['medium', 'medium']", (), r"two: 3agent_hopper-medium-two is there twice"),
        ("", ("--seeds", "0-9"), r"^--seeds '0-9': write 0\.\.9"),
        ("seeds = '0-9'", (), r"twice\.toml: --seeds '0-9': write 0\.\.9"),
    ],
)
def test_a_mistake_is_one_clear_line(
    file: Path, change: str | None, flags: tuple[str, ...], expected: str, tmp_path: Path
) -> None:
    """`change`: what is added to the file; None: the flags name the campaign, or none."""
    if change is not None:
        seeds, _, parts = file.read_text().partition("\n")
        if change.startswith("seeds"):
            file.write_text(f"{change}\n{parts}")
        elif change.startswith("sedes"):
            file.write_text(f"{change}\n{seeds}\n{parts}")
        else:
            file.write_text(f"{seeds}\n{parts}{change}\n")
        flags = (str(file), *flags)
    out = tmp_path / "out"
    beside = () if change is None else ("--quick", "--out", str(out))
    with pytest.raises(UserError, match=expected) as error:
        launch(*flags, *beside)
    assert "\n" not in str(error.value)
    assert not out.exists()
