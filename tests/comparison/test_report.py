import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from otc_dist.comparison import collected, report, tables
from otc_dist.comparison.arms import Arms
from otc_dist.comparison.score_statistics import Summary, summarise
from otc_dist.comparison.scores import ComparisonFolder, Run
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.report.__main__ import main as report_command
from otc_dist.run.measured_returns import Measured
from otc_dist.terminal.errors import UserError

from .conftest import SEEDS


def read(
    folder: ComparisonFolder, arms: Arms, base: Description, *seeds: int
) -> tuple[Summary, dict[str, list[Run]]]:
    runs = {arm: [Run.read(folder.run(seed, arm)) for seed in seeds] for arm in arms}
    return summarise(runs, lambda value: registry.normalised_score(base.env.id, value)), runs


def test_the_report_needs_nothing_but_itself(
    finished: ComparisonFolder, arms: Arms, base: Description
) -> None:
    summary, runs = read(finished, arms, base, *SEEDS)
    report.write(finished, base, arms, summary, runs, "a quick look")
    page = finished.report.read_text()

    class Links(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            assert tag not in ("script", "link", "img", "iframe")
            assert not {name for name, _ in attrs} & {"src", "href"}

    Links().feed(page)
    assert "url(" not in page and "@import" not in page
    assert page.count("<svg") >= 3  # returns, differences, alpha
    assert "This is a quick look." in page and "Fewer than 10 seeds." in page
    for arm in arms:
        assert arm in page


def test_the_json_holds_what_the_tables_show(
    finished: ComparisonFolder, arms: Arms, base: Description
) -> None:
    summary, runs = read(finished, arms, base, 0)
    report.write(finished, base, arms, summary, runs)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    found = json.loads(finished.results.read_text(), parse_constant=refuse)
    assert found["seeds"] == [0] and found["label"] == ""
    assert [arm["name"] for arm in found["arms"]] == list(arms)
    first = found["arms"][0]["measures"]["return"]["deployments"][0]
    assert first["mean"] == summary.arms[0].measures["return"].deployments[0].mean
    assert first["std"] is None  # one seed


def test_the_report_command_writes_a_comparison_s_page_again(
    finished: ComparisonFolder,
    arms: Arms,
    base: Description,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = ComparisonFolder(Path(shutil.copytree(finished.root, tmp_path / "copy")))
    for path in (folder.results, folder.report):
        path.unlink(missing_ok=True)
    with pytest.raises(UserError, match="no seed is complete yet"):
        report_command([str(folder.root)])
    report.write(folder, base, arms, *read(folder, arms, base, *SEEDS), "a quick look")
    before = {path: path.read_bytes() for path in (folder.results, folder.report)}
    folder.report.unlink()
    with pytest.raises(UserError, match="nowhere is not a run folder"):
        report_command([str(folder.root), str(tmp_path / "nowhere")])
    kept = tmp_path / "kept"
    collected.keep(folder, arms, SEEDS, kept)
    with pytest.raises(UserError, match=f"launch compare --tables {kept} shows them"):
        report_command([str(folder.root), str(kept)])
    assert not (kept / "report.html").exists()
    assert not folder.report.exists()  # a mistake in one before any is written
    assert report_command([str(folder.root)]) == 0
    assert capsys.readouterr().out == f"{folder.report}\n"
    assert {path: path.read_bytes() for path in before} == before
    folder.results.write_text('{"label": "", "arms": [{"name": "../../elsewhere"}]}')
    with pytest.raises(UserError, match=r"comparison\.json is damaged: arms\.0\.name"):
        report_command([str(folder.root)])


def test_the_page_says_how_often_an_arm_went_back(
    finished: ComparisonFolder, arms: Arms, base: Description
) -> None:
    summary, found = read(finished, arms, base, *SEEDS)
    fell = [Measured(2.0, 0.1, 4), Measured(1.0, 0.1, 4)]
    runs = {name: [replace(one, measured=fell) for one in own] for name, own in found.items()}
    back = {name: (*own, "deployment.revert=true") for name, own in arms.items()}
    one, *others = arms
    page = report.page(base, {**arms, one: back[one]}, summary, runs)
    said = f"{one}: after {len(SEEDS)} of {2 * len(SEEDS)} deployments tuning went back to an"
    assert said in page
    assert not any(f"{name}: after" in page for name in others)


def test_the_text_has_a_row_for_every_policy(
    finished: ComparisonFolder, arms: Arms, base: Description
) -> None:
    summary, _ = read(finished, arms, base, *SEEDS)
    lines = list(tables.text(summary))
    for k in range(base.deployment.count + 1):
        assert sum(line.startswith(f"pi_{k} ") for line in lines) == 4  # one a measure
    rows = sum(bool(re.match(r"uniform-null .*\[.*\]", line)) for line in lines)
    assert rows == 5  # two gains over pi_0, three differences from the reference
    assert lines[-1].strip() == summary.conclusion
