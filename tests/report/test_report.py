"""A run's report says what its files say, and says what it does not know."""

import json
import math
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from otc_dist.report.return_statistics import Spread, improvement
from otc_dist.report.write import write_report
from otc_dist.terminal.errors import UserError

VOID = {"meta", "line", "path", "br", "polygon"}


class Page(HTMLParser):
    """Collects text, tags and attributes, and checks that tags are closed in order."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.texts: list[str] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag != "meta":
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs) -> None:
        self.tags.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.texts)


def report(made) -> tuple[dict, Page]:
    path = write_report(made.folder)
    assert path == made.folder.report
    return json.loads(made.folder.results.read_text()), Page(path.read_text(encoding="utf-8"))


def test_results_hold_the_raw_numbers_and_what_follows_from_them(made) -> None:
    results, _ = report(made)
    assert results["complete"] is True and results["missing"] == []
    assert [e["returns"] for e in results["evaluations"]] == [
        [-10, -30], [-10, -10], [0, 20], [10, 30],
    ]  # fmt: skip
    assert results["evaluations"][2]["policies"] == {"agent_0": "digest 2"}
    last = results["table"][-1]
    # R_0 = -20, R_3 = 20: 100 (20 - -20) / |-20|.
    std = pytest.approx(200**0.5)  # of 10 and 30, ddof 1
    values = {"mean": 20, "std": std, "iqm": 20, "minimum": 10, "maximum": 30, "count": 2}
    assert last["returns"] == values
    assert (last["improvement"], last["gain"], last["length"]) == (200.0, 4.0, 150.0)
    assert (results["table"][0]["improvement"], results["table"][0]["gain"]) == (None, None)
    # The mean over deployments of (-10, 10, 20).
    assert results["tuned"]["mean_return"] == pytest.approx(20 / 3)
    assert results["tuned"]["improvement"] == pytest.approx(100 * (20 / 3 + 20) / 20)
    assert results["agents"]["agent_1"]["tunings"][1] == {
        "deployment": 2, "alpha": 0.5, "similarity": 1.5,
    }  # fmt: skip
    assert results["agents"]["agent_1"]["active_dimensions"] == 7
    assert results["wall_seconds"] == 5400
    assert (results["seed"], results["versions"]) == (5, {"torch": "2.7.0"})
    assert results["description_digest"] == made.description.digest()
    assert results["dataset"]["returns"]["mean"] == 10


def test_the_page_is_whole_and_needs_nothing_else(made) -> None:
    _, page = report(made)
    assert {"script", "link", "img", "iframe", "object"}.isdisjoint(page.tags)
    assert not any(name in ("src", "href", "xlink:href") for name, _ in page.attributes)
    assert "url(" not in made.folder.report.read_text() and "@import" not in page.text
    for text in (
        "Return over deployments", "Prioritization strength alpha", "agent_1", "offline",
        "+200.0 %", "+4.0", "1 h 30 min", "hopper-3x1/medium-replay", "10 ± 2 (5 … 15)",
        "python -m otc_dist.launch made --set 'env.copies=1 2'", "torch", "2.7.0",
        made.description.digest(),
    ):  # fmt: skip
        assert text in page.text, text
    assert "not a result" not in page.text and "not complete" not in page.text


def test_a_phone_gets_charts_that_are_drawn_for_it(made) -> None:
    """And no letter is smaller there than on a screen."""
    report(made)
    html = made.folder.report.read_text(encoding="utf-8")
    pairs = re.findall(r'class="(wide|narrow)"><svg class="chart" viewBox="0 0 (\d+) ', html)
    assert pairs == [("wide", "960"), ("narrow", "360")] * 2
    assert "min-width: 400px" not in html and "@media screen and (max-width: 700px)" in html


def test_charts_of_one_quantity_have_axes_of_one_kind(made) -> None:
    """Alpha alone is spread so widely that its axis is logarithmic: then so is that of 𝔻."""
    made.report("agent_0", "tuning", 3, 0, 100, alpha=1000.0, similarity=2.0)
    report(made)
    html = made.folder.report.read_text(encoding="utf-8")
    charts = {
        title: re.findall(r'text-anchor="(?:end|middle)">([\d.,]+)</text>', svg)
        for title, svg in re.findall(r'aria-label="([^"]+)".*?</title>(.*?)</svg>', html)
    }
    alpha, similarity = (charts[title] for title in charts if title[:5] in ("Prior", "Expec"))
    assert {"1", "10", "100", "1,000"} <= set(alpha) and {"1", "2"} <= set(similarity)
    assert alpha[-4:] == similarity[-4:] == ["0", "1", "2", "3"]  # deployments


def test_a_task_without_reference_returns_has_no_score(made) -> None:
    for k in range(4):
        data = json.loads(made.folder.evaluation(k).read_text())
        made.folder.evaluation(k).write_text(json.dumps(data | {"normalised_score": None}))
    results, page = report(made)
    assert results["tuned"]["mean_score"] is None and results["tuned"]["gain"] is None
    assert results["tuned"]["improvement"] is not None and "+200.0 %" in page.text


def test_a_task_whose_episodes_are_won_shows_how_many(made) -> None:
    _, page = report(made)
    assert "won" not in page.text
    for k, won in enumerate([[False, False], [True, False], [True, True], [True, True]]):
        data = json.loads(made.folder.evaluation(k).read_text())
        made.folder.evaluation(k).write_text(json.dumps(data | {"successes": won}))
    results, page = report(made)
    assert [row["success"] for row in results["table"]] == [0, 50, 100, 100]
    assert results["tuned"]["mean_success"] == pytest.approx(250 / 3)
    assert "83.3 %" in page.text and "episodes won" in page.text


def test_a_quick_run_is_labelled(made) -> None:
    made.write_record(quick=True)
    results, page = report(made)
    assert results["label"] == "a quick look, not a result"
    assert "A quick look, not a result." in page.text


def test_an_unfinished_run_has_an_unfinished_report(made) -> None:
    made.write_record(state="running", finished=None)
    for k in (2, 3):
        made.folder.evaluation(k).unlink()
        made.folder.deployment(k).unlink()
    results, page = report(made)
    assert results["complete"] is False and len(results["evaluations"]) == 2
    assert results["wall_seconds"] > 0
    assert "1 of 3 deployments and 2 evaluations so far; its state is 'running'" in page.text


def test_a_run_that_has_only_begun(made) -> None:
    for path in (made.folder.run_json, made.folder.dataset_card):
        path.unlink()
    for folder in ("evaluations", "deployments", "agents"):
        shutil.rmtree(made.folder.root / folder)
    results, page = report(made)
    assert results["evaluations"] == [] and results["tuned"] is None
    assert results["missing"] == [
        "run.json is missing", "dataset_card.json is missing", "no agent has reported yet",
    ]  # fmt: skip
    assert "no data yet" in page.text


def test_damaged_files_are_named_and_the_rest_is_reported(made) -> None:
    made.folder.evaluation(2).write_text('{"evaluation": 2, "retur')
    made.folder.evaluation(1).write_text(
        json.dumps(
            {
                "evaluation": 1,
                "returns": [float("nan")],
                "lengths": [1],
                "seeds": [1],
                "policies": {},
                "normalised_score": None,
            }
        )
    )
    made.folder.metrics("agent_0").write_text("no json\nat all\n")
    results, page = report(made)
    assert [e["deployment"] for e in results["evaluations"]] == [0, 3]
    assert list(results["agents"]) == ["agent_1"]
    assert results["complete"] is False
    for name in ("evaluation_01.json", "evaluation_02.json", "metrics.jsonl"):
        assert name in " ".join(results["missing"])
    assert "Not in this report:" in page.text


def test_a_line_that_a_killed_learner_left_unfinished_is_left_out(made) -> None:
    with made.folder.metrics("agent_0").open("a") as stream:
        stream.write('{"phase": "tuning", "depl')
    results, _ = report(made)
    assert results["missing"] == [] and len(results["agents"]["agent_0"]["tunings"]) == 3


def test_a_learner_that_was_restarted_counts_once(made) -> None:
    before, _ = report(made)
    for update in (0, 100):
        made.report("agent_0", "tuning", 3, update, 100, alpha=1 / 3, similarity=1.0)
    after, _ = report(made)
    assert before == after


def test_where_there_is_no_alpha_the_accepted_share_is_shown(made) -> None:
    for agent in ("agent_0", "agent_1"):
        made.folder.metrics(agent).unlink()
        made.report(agent, "tuning", 1, 0, 100, accepted=0.1, guarded=0.0)
        made.report(agent, "tuning", 1, 100, 100, q=3.0)
    results, page = report(made)
    assert results["agents"]["agent_0"]["tunings"] == [{"deployment": 1, "accepted": 0.1}]
    assert "Share of B_k that is accepted" in page.text
    assert "Prioritization strength alpha" not in page.text


def test_numbers_that_are_not_finite_are_null(made) -> None:
    made.report("agent_0", "tuning", 3, 0, 100, alpha=float("nan"), similarity=float("inf"))
    results, _ = report(made)
    assert results["agents"]["agent_0"]["tunings"][2] == {
        "deployment": 3, "alpha": None, "similarity": None,
    }  # fmt: skip


def test_what_users_write_is_no_markup(made) -> None:
    made.write_record(command="python <script>alert(1)</script>", run="<b>&")
    _, page = report(made)
    assert "script" not in page.tags and "<script>alert(1)</script>" in page.text


def test_no_run_folder(tmp_path: Path) -> None:
    out = subprocess.run(
        [sys.executable, "-m", "otc_dist.report", str(tmp_path)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert out.returncode == 2 and out.stdout == ""
    assert re.fullmatch(r"error: .* is not a run folder: it has no description.toml\n", out.stderr)


def test_the_command_reports_every_run(made) -> None:
    out = subprocess.run(
        [sys.executable, "-m", "otc_dist.report", str(made.folder.root), str(made.folder.root)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (out.returncode, out.stderr) == (0, "")
    assert out.stdout == f"{made.folder.report}\n" * 2


def test_a_report_that_cannot_be_written_leaves_nothing_half_written(made) -> None:
    made.folder.report.mkdir()
    with pytest.raises(UserError, match=r"report.html cannot be written"):
        write_report(made.folder)
    assert not list(made.folder.root.glob("*.partial"))


@pytest.mark.parametrize(
    ("value", "before", "expected"),
    [(150, 100, 50), (-50, -100, 50), (-150, -100, -50), (5, 0, None), (float("nan"), 1, None)],
)
def test_improvement(value: float, before: float, expected: float | None) -> None:
    assert improvement(value, before) == expected


def test_spread() -> None:
    found = Spread.of([1.0, 3.0])
    assert found == Spread(2.0, 2**0.5, 2.0, 1.0, 3.0, 2) and str(found) == "2.0 ± 1.4"
    assert Spread.of([5.0]).band == (5.0, 5.0) and str(Spread.of([5.0])) == "5.0"
    for nothing in ([], [1.0, math.inf]):
        assert math.isnan(Spread.of(nothing).mean) and math.isnan(Spread.of(nothing).std)


def test_a_line_that_was_written_behind_a_torn_one_is_read(made) -> None:
    """As earlier versions did when a learner was killed in the middle of a line."""
    with made.folder.metrics("agent_0").open("a") as file:
        file.write('{"phase": "tuning", "deploym')
    made.report("agent_0", "tuning", 3, 0, 100, alpha=0.25)
    with made.folder.metrics("agent_0").open("a") as file:
        file.write('{"phase": "tuni')  # and this one is being written
    results, _ = report(made)
    assert results["missing"] == []
    assert results["agents"]["agent_0"]["tunings"][2]["alpha"] == 0.25


def test_whoever_may_only_look_gets_the_report_elsewhere(made, tmp_path: Path) -> None:
    here = tmp_path / "here"
    here.mkdir()
    root = str(made.folder.root)
    script = f"mount -o bind,ro {root} {root} && exec {sys.executable} -m otc_dist.report {root}"
    for entry in (["unshare", "--mount"], ["unshare", "--user", "--map-root-user", "--mount"]):
        if shutil.which("unshare") and not subprocess.call(
            [*entry, "true"], stderr=subprocess.DEVNULL
        ):
            break
    else:
        pytest.skip("mount namespaces are not permitted")
    out = subprocess.run(
        [*entry, "sh", "-c", script], cwd=here, capture_output=True, text=True, check=False
    )
    assert (out.returncode, out.stdout) == (0, f"{here}/run-report.html\n")
    assert out.stderr == f"{root} cannot be written: its report is made here\n"
    assert {path.name for path in here.iterdir()} == {"run-report.html", "run-results.json"}
