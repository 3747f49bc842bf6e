"""The numbers of the documentation are those that the committed raw scores give."""

import itertools
import json
import re
import runpy
import shutil
import statistics
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import pytest

from otc_dist.comparison import collected, tables
from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.comparison.intervals import Difference
from otc_dist.comparison.judgement import over_deployments, recommended, returns
from otc_dist.comparison.mechanism import table
from otc_dist.comparison.score_statistics import summarise
from otc_dist.comparison.scores import Run

ROOT = Path(__file__).parents[1]
FIGURES = 10  # and tables of the paper that make a claim
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# A block that `compare --tables FOLDER`, or `mechanism`, printed, whole or in parts.
QUOTED = re.compile(r"<!-- (tables|mechanism): (\S+) -->\n```text\n(.*?)```", re.S)
QUOTES = [
    pytest.param(kind, folder, block, id=f"{page.name}, {folder}")
    for page in PAGES
    for kind, folder, block in QUOTED.findall(page.read_text())
]


@cache
def printed(kind: str, folder: str) -> set[str]:
    """The lines that the raw scores of a folder give."""
    if kind == "mechanism":
        return set(table.read(sorted((ROOT / folder).glob("*.json"))).lines())
    found = collected.collect(ROOT / folder)
    return set("\n".join(tables.text(summarise(found.runs, found.normalise))).splitlines())


def test_something_is_quoted() -> None:
    assert QUOTES


@pytest.mark.parametrize(("kind", "folder", "block"), QUOTES)
def test_what_is_quoted_is_what_the_raw_scores_give(kind: str, folder: str, block: str) -> None:
    for line in block.splitlines():
        assert not line or line in printed(kind, folder), line


def test_every_folder_of_raw_scores_is_quoted() -> None:
    kept = {str(path.relative_to(ROOT)) for path in ROOT.glob("results/tuning/*/")}
    assert kept == {str(folder) for param in QUOTES for folder in param.values[1:2]}


def test_the_readme_says_what_is_selected_in_the_measured_numbers() -> None:
    paths = sorted((ROOT / "results/tuning/mechanism-hopper").glob("*.json"))
    rows = {row.name: row for row in table.read(paths).rows}
    typical, corrected = (rows[f"{name}, best tenth"] for name in ("typical", "d_f"))
    assert (
        f"they would do now as uniform sampling's ({typical.mismatch.mean:.2f}), and s' has"
        f" {typical.error.mean:.2f} of the squared error; d_f {corrected.mismatch.mean:.2f} and"
        f" {corrected.error.mean:.2f}."
    ) in said("README.md").replace("\N{PRIME}", "'")


def test_why_it_harmed_is_told_in_the_measured_numbers() -> None:
    page = (ROOT / "docs" / "tuning.md").read_text()
    folder = ROOT / "results/tuning/choose-hopper/seed_00"
    for arm in ("otc-embedding", "embedding-all"):
        run = Run.read(folder / f"{arm}.json")
        values = " | ".join(f"{value:,.0f}" for value in returns(run))
        alphas = " ".join(f"{told['agent_0']['alpha']:.2f}" for told in run.told)
        assert f"| {values} | {alphas} |" in page, arm


def test_the_paper_s_pages_are_what_its_raw_scores_give() -> None:
    written = runpy.run_path(str(ROOT / "docs" / "paper.py"))
    drawn, said = ROOT / "docs" / "paper.html", (ROOT / "docs" / "paper.md").read_text()
    assert said == written["page"](), "run `python docs/paper.py`"
    there = drawn.read_text() if drawn.exists() else None
    assert there == written["drawn"](), "run `python docs/paper.py`"


def test_the_paper_s_page_says_what_is_reproduced_as_soon_as_there_are_scores(
    tmp_path: Path,
) -> None:
    """Of scores that lie here for another page, under the names that the campaign has."""
    written = runpy.run_path(str(ROOT / "docs" / "paper.py"))
    page, drawn = written["page"], written["drawn"]
    assert "Nothing of it has been run yet" in page(tmp_path)
    assert page(tmp_path).count(" | Not run. |") == FIGURES and drawn(tmp_path) is None
    one = tmp_path / "3agent_hopper-medium-replay-bcq"
    later = shutil.ignore_patterns("seed_2[5-9]")
    shutil.copytree(ROOT / "results/tuning/td3bc-hopper", one, ignore=later)
    for arm in ("paper-embedding", "paper-value"):
        for path in one.glob("seed_*/uniform.json"):
            scores = json.loads(path.read_text()) | {"arm": arm}
            (path.parent / f"{arm}.json").write_text(json.dumps(scores))
    job = {"processor_seconds": 7200.0, "processor": "any"}
    (one / "seed_20" / "spent.json").write_text(json.dumps({"uniform": job, "pi_0": job}))
    shutil.copy(ROOT / "launch/campaigns/paper-table1.toml", tmp_path)
    said = page(tmp_path)
    assert "Complete so far: 5 to 5 seeds of 1 comparisons, in 4 hours of one core." in said
    assert said.count(" | Not run. |") == FIGURES - 1
    assert re.search(
        r"\| Table 1 and Figure 3: BCQ \| .* \| Not reproduced: paper-embedding minus", said
    )
    assert re.search(r"^hopper-3x1/medium-replay +2\.7 ± 26\.3 +2\.7 ± 26\.3", said, re.M)
    assert drawn(tmp_path).count("<p>Not run</p>") == FIGURES - 1

    # The same scores as if they were those of another of the paper's campaigns.
    two = tmp_path / "navigation-random-figure6c"
    shutil.copytree(one, two)
    task = 'name = "navigation"\nenv.id = "navigation"\ndataset.name = "navigation/random"\n'
    (two / "description.toml").write_text(task)
    shutil.copy(ROOT / "launch/campaigns/paper-figure6c.toml", tmp_path)
    both, shown = page(tmp_path), drawn(tmp_path)
    assert both.count(" | Not run. |") == shown.count("<p>Not run</p>") == FIGURES - 2
    assert re.search(
        r"\| Figure 6c: Navigation, BCQ \| .* \| Undecided: paper-embedding minus .* by chance, .*"
        r" 1 data set, 5 seeds\. \|",
        both,
    )
    (panel,) = (x for x in shown.split("<section>") if x.startswith("<h2>Figure 6c"))
    assert panel.count("<svg") == 1 and ">navigation/random<" in panel and ">return<" in panel
    assert "figure6c: gain, recommended" in both
    assert both.count("published") == said.count("published")  # nothing is of this figure


def said(page: str) -> str:
    return " ".join((ROOT / page).read_text().split())


def gained(run: Run) -> float:
    """Of pi_0's return."""
    return (recommended(run) or 0.0) / returns(run)[0] - 1


def gain_of(runs: Sequence[Run]) -> str:
    gains = [gained(run) for run in runs]
    return f"{sum(gain > 0 for gain in gains)} of {len(gains)} seeds"


def by_t(found: Difference) -> str:
    return f"{found.mean:+,.0f} [{found.t_low:+,.0f}, {found.t_high:+,.0f}]"


# The default of a robot's description, algorithm and arm, and what stands beside it in the table.
DEFAULTS = {
    "Hopper": ("bremen", "rlpd", REFERENCE, "uniform sampling"),
    "Walker2d": ("bremen", "rlpd", REFERENCE, "uniform sampling"),
    "HalfCheetah": ("half", "rlpd", REFERENCE, "uniform sampling"),
}


@cache
def default_runs() -> dict[str, dict[str, list[Run]]]:
    """The scores of every robot's default."""
    return {
        robot: collected.collect(ROOT / f"results/tuning/{algorithm}-{robot.lower()}").runs
        for robot, (algorithm, *_) in DEFAULTS.items()
    }


def over_pi_0(runs: Sequence[Run], of: Callable[[Run], float | None]) -> Difference:
    """What `of` gives of a run, minus pi_0's return."""
    return Difference.of({run.seed: (of(run) or 0.0) - returns(run)[0] for run in runs})


@pytest.mark.parametrize("robot", DEFAULTS)
def test_what_the_default_brings_is_told_in_the_measured_numbers(robot: str) -> None:
    runs, (_, default, beside, called) = default_runs()[robot], DEFAULTS[robot]
    for arm, name in ((default, robot), (beside, f"{robot}, {called}")):
        first = statistics.mean(returns(run)[0] for run in runs[arm])
        found = {run.seed: recommended(run) or 0.0 for run in runs[arm]}
        gain = over_pi_0(runs[arm], recommended)
        over = over_pi_0(runs[arm], over_deployments)
        relative = statistics.median(gained(run) for run in runs[arm])
        assert (
            f"| {name} | {first:,.0f} | {statistics.mean(found.values()):,.0f} | {by_t(gain)} |"
            f" {gain.above} of {len(found)} | {relative:+.0%} | {by_t(over)} |"
        ) in said("README.md")
    told = f"{gain_of(runs[default])} of {robot}"
    assert told in said("README.md") and told in said("docs/tuning.md")
    medians = [
        statistics.median(map(gained, default_runs()[one][arm]))
        for one, (_, arm, *_) in DEFAULTS.items()
    ]
    by = f"by {medians[0]:.0%}, {medians[1]:.0%} and {medians[2]:.0%} in the median"
    assert by in said("README.md")


@pytest.mark.parametrize("robot", DEFAULTS)
@pytest.mark.parametrize(
    ("arm", "beside"),
    [("rlpd", None), (REFERENCE, None), (NULL, None), ("rlpd", REFERENCE), (NULL, REFERENCE)],
)
def test_what_half_online_data_bring_is_told_in_the_measured_numbers(
    arm: str, beside: str | None, robot: str
) -> None:
    """The table of what an arm returns above pi_0 (`beside` None), or above another arm."""
    runs, called = default_runs()[robot], {"rlpd": "half online", NULL: "null arm"}
    brought = (recommended, over_deployments, lambda run: returns(run)[-1])

    def minus(of: Callable[[Run], float | None]) -> Difference:
        if beside is None:
            return over_pi_0(runs[arm], of)
        other = {run.seed: of(run) or 0.0 for run in runs[beside]}
        return Difference.of({run.seed: (of(run) or 0.0) - other[run.seed] for run in runs[arm]})

    cells = " | ".join(by_t(minus(of)) for of in brought)
    row = f"| {called.get(arm, arm)}, minus {beside or 'pi_0'} | {cells} |"
    assert row in said("docs/tuning.md")
    if arm == "rlpd":
        assert by_t(minus(over_deployments)) in said("README.md")


@pytest.mark.parametrize("robot", DEFAULTS)
def test_what_was_expected_is_told_beside_what_came_out(robot: str) -> None:
    runs = default_runs()[robot]
    half, uniform = runs["rlpd"], {run.seed: over_deployments(run) for run in runs[REFERENCE]}
    returned = statistics.mean(recommended(run) or 0.0 for run in half)
    over = statistics.median(over_deployments(run) / returns(run)[0] - 1 for run in half)
    more = statistics.mean(over_deployments(run) - uniform[run.seed] for run in half)
    above, median = gain_of(half).removesuffix(" seeds"), statistics.median(map(gained, half))
    page = said("docs/tuning.md")
    assert f"it is in {above}, and {median:.0%}" in page
    assert f"came out as {returned:,.0f}, {over:.0%} in the median, and {more:,.0f}." in page


@pytest.mark.parametrize("robot", ["Hopper", "Walker2d", "HalfCheetah"])
def test_what_otc_s_arms_bring_is_told_in_the_measured_numbers(robot: str) -> None:
    """How much more than uniform sampling's do their recommended policies return?"""
    runs = collected.collect(ROOT / f"results/tuning/td3bc-{robot.lower()}").runs
    found = {arm: {run.seed: recommended(run) or 0.0 for run in of} for arm, of in runs.items()}
    for arm, pages in (
        ("typical-share", ("README.md", "docs/tuning.md")),
        ("random-share", ("docs/tuning.md",)),
    ):
        assert len(found[arm]) == 10
        minus = {seed: value - found["uniform"][seed] for seed, value in found[arm].items()}
        for page in pages:
            assert f"{by_t(Difference.of(minus))} on {robot}" in said(page), (arm, page)


def swing(folder: str) -> float:
    """How far the return moves from one policy of a run to the next, with uniform sampling."""
    runs = collected.collect(ROOT / "results/tuning" / folder).runs
    steps = [
        abs(after - before)
        for arm in ("uniform", "uniform-null")
        for run in runs[arm]
        for before, after in itertools.pairwise(returns(run))
    ]
    return statistics.mean(steps)


def test_how_far_policies_swing_is_told_in_the_measured_numbers() -> None:
    pairs = [("hopper", "td3bc-hopper"), ("halfcheetah", "td3bc-halfcheetah")]
    hopper, cheetah = (
        f"{swing(bcq):.0f} with BCQ and {swing(ours):.0f} with TD3+BC" for bcq, ours in pairs
    )
    assert f"{hopper} on Hopper, {cheetah} on HalfCheetah" in said("docs/tuning.md")


def test_what_the_recommended_policies_of_bcq_gain_is_told_in_the_measured_numbers() -> None:
    """What one arm returns beside another, as the page says it in a sentence."""
    page = said("docs/tuning.md")
    runs = collected.collect(ROOT / "results/tuning/hopper").runs
    found = {arm: {run.seed: recommended(run) or 0.0 for run in of} for arm, of in runs.items()}
    assert all(len(seeds) == 10 for seeds in found.values())

    def minus(arm: str, other: str) -> str:
        by_seed = {seed: value - found[other][seed] for seed, value in found[arm].items()}
        return by_t(Difference.of(by_seed))

    typical, null = (minus(arm, "uniform") for arm in ("typical-share", "uniform-null"))
    assert typical in page and null in page
    assert f"OTC minus the null arm is {minus('typical-share', 'uniform-null')}" in page
    assert f"minus a random tenth {minus('typical-share', 'random-share')}" in page
    assert minus("random-share", "uniform").split(" ", 1)[1] in page
    for arm in ("typical-share", "uniform", "uniform-null"):
        gains = [gained(run) for run in runs[arm]]
        above, median = sum(gain > 0 for gain in gains), statistics.median(gains)
        assert re.search(rf"{above} of 10|in {above} ", page), (arm, above)
        assert f"{median:.0%}" in page, (arm, median)
