"""The numbers of the documentation are those that the committed raw scores give."""

import re
from functools import cache
from pathlib import Path

import pytest

from otc_dist.comparison import collected, mechanism_table, tables
from otc_dist.comparison.judgement import returns
from otc_dist.comparison.scores import Run
from otc_dist.comparison.statistics import summarise

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
        return set(mechanism_table.read(sorted((ROOT / folder).glob("*.json"))).lines())
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
    rows = {row.name: row for row in mechanism_table.read(paths).rows}
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
