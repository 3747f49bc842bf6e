"""The numbers of the documentation are those that the committed raw scores give."""

import re
import statistics
from functools import cache
from pathlib import Path

import pytest

from otc_dist.comparison import collected, tables
from otc_dist.comparison.intervals import Difference
from otc_dist.comparison.judgement import recommended, returns
from otc_dist.comparison.mechanism import table
from otc_dist.comparison.score_statistics import summarise
from otc_dist.comparison.scores import Run

ROOT = Path(__file__).parents[1]
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
    said = " ".join((ROOT / "README.md").read_text().replace("\N{PRIME}", "'").split())
    assert (
        f"they would do now as uniform sampling's ({typical.mismatch.mean:.2f}), and s' has"
        f" {typical.error.mean:.2f} of the squared error; d_f {corrected.mismatch.mean:.2f} and"
        f" {corrected.error.mean:.2f}."
    ) in said


def test_why_it_harmed_is_told_in_the_measured_numbers() -> None:
    page = (ROOT / "docs" / "results.md").read_text()
    folder = ROOT / "results/tuning/choose-hopper/seed_00"
    for arm in ("otc-embedding", "embedding-all"):
        run = Run.read(folder / f"{arm}.json")
        values = " | ".join(f"{value:,.0f}" for value in returns(run))
        alphas = " ".join(f"{told['agent_0']['alpha']:.2f}" for told in run.told)
        assert f"| {values} | {alphas} |" in page, arm


def test_what_the_recommended_policies_gain_is_told_in_the_measured_numbers() -> None:
    """What one arm returns beside another, as the pages say it in a sentence."""
    page, readme = (
        " ".join((ROOT / name).read_text().split()) for name in ("docs/results.md", "README.md")
    )
    runs = collected.collect(ROOT / "results/tuning/hopper").runs
    found = {arm: {run.seed: recommended(run) or 0.0 for run in of} for arm, of in runs.items()}
    assert all(len(seeds) == 10 for seeds in found.values())

    def minus(arm: str, other: str) -> str:
        by_seed = {seed: value - found[other][seed] for seed, value in found[arm].items()}
        difference = Difference.of(by_seed)
        return f"{difference.mean:+,.0f} [{difference.t_low:+,.0f}, {difference.t_high:+,.0f}]"

    for arm in ("typical-share", "uniform-null"):
        assert minus(arm, "uniform") in page and minus(arm, "uniform") in readme, arm
    assert f"OTC minus the null arm is {minus('typical-share', 'uniform-null')}" in page
    assert f"minus a random tenth {minus('typical-share', 'random-share')}" in page
    assert minus("random-share", "uniform").split(" ", 1)[1] in page
    for arm in ("typical-share", "uniform", "uniform-null"):
        gains = [
            returns_of / first - 1
            for run in runs[arm]
            for returns_of, first in [(recommended(run) or 0.0, returns(run)[0])]
        ]
        above, median = sum(gain > 0 for gain in gains), statistics.median(gains)
        for text in (page, readme):
            assert re.search(rf"{above} of 10|in {above} ", text), (arm, above)
            assert f"{median:.0%}" in text, (arm, median)
