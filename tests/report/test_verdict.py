"""A report and a run's last lines begin with what happened, good or bad, in a sentence."""

import io
import sys

import pytest

from otc_dist.launch.show.summary import show_summary, summary_lines
from otc_dist.report.numbers import MINUS, NOTHING, columns
from otc_dist.report.run_data import read_run
from otc_dist.report.verdict import verdict
from otc_dist.run.folder import RunFolder

from .conftest import MadeRun
from .test_report import report

OFFLINE = [100.0, 110.0]


def result(made: MadeRun) -> tuple[str, str]:
    """The sentence of the results, which the page and the last lines begin with as well."""
    results, page = report(made)
    found = results["verdict"]
    assert ("class", f"verdict {found['tone']}") in page.attributes
    order = [page.text.index(found["sentence"]), page.text.index("Return over deployments")]
    assert order == sorted(order)
    assert next(summary_lines(made.folder)) == found["sentence"]
    return found["tone"], found["sentence"].replace(MINUS, "-")


@pytest.mark.parametrize(
    ("last", "tone", "sentence"),
    [
        (
            [200.0, 211.0],
            "good",
            "Tuning helped: the recommended policy, pi_3, returns 205.5 (+100.5, +95.7 %), the"
            " offline one 105.0.",
        ),
        (
            [30.0, 41.0],
            "bad",
            "Tuning did harm: the recommended policy, pi_3, returns 35.5 (-69.5, -66.2 %), the"
            " offline one 105.0.",
        ),
        (
            [90.0, 130.0],
            "open",
            "No clear change: the recommended policy, pi_3, returns 110.0 (+5.0, +4.8 %), the"
            " offline one 105.0; too close for 2 episodes to tell.",
        ),
    ],
)
def test_what_the_recommended_policy_has_over_the_offline_one(
    made: MadeRun, last: list[float], tone: str, sentence: str
) -> None:
    made.describe("deployment.keep=last")
    made.evaluate(0, OFFLINE)
    made.evaluate(3, last)
    assert result(made) == (tone, sentence)


@pytest.mark.parametrize(
    ("last", "tone", "so"),
    [
        ([30.0, 41.0], "bad", "Tuning did harm, so the offline policy is recommended: it returns"),
        ([200.0, 211.0], "open", "Tuning helped in the end, but the deployments spoke for the"),
        ([90.0, 130.0], "open", "Nothing shows that tuning helped, so the offline policy is"),
    ],
)
def test_the_offline_policy_is_recommended(
    made: MadeRun, last: list[float], tone: str, so: str
) -> None:
    made.folder.deployment(1).unlink()
    made.deploy(1, [10.0, 12.0])
    made.evaluate(0, OFFLINE)
    made.evaluate(3, last)
    found = result(made)
    assert found[0] == tone and found[1].startswith(so)
    assert "105.0, the last tuned one, pi_3, " in found[1]


def test_the_last_and_the_best_policy_and_the_data_are_told_beside_it(made: MadeRun) -> None:
    found = verdict(read_run(made.folder))
    so = "No clear change: the recommended policy, pi_1, returns -10.0"
    assert found.sentence.replace(MINUS, "-").startswith(so)
    assert found.more == (
        "The last tuned policy, pi_3, returns 20.0 (+40.0, +200.0 %): too close to the"
        " offline one to tell.",
        "The best of the 4 policies in the same episodes, as is known only afterwards, is pi_3:"
        " 20.0.",
        "The episodes in the data return 10.0 on average.",
    )
    assert "mean of the data" in report(made)[1].text  # a line in the plot


def test_a_run_with_uniform_sampling_beside_it_is_the_reference(made: MadeRun) -> None:
    other = MadeRun(made.folder.root.parent / "with-uniform")
    other.describe("sampling.name=uniform")
    report(other)
    assert read_run(other.folder).uniform is None  # it is the reference itself
    made.describe("sampling.distance=value", "sampling.acceptance=rank")
    results, page = report(made)
    assert results["uniform"] == {"folder": "with-uniform", "policy": 1, "greedy_return": -10}
    assert "uniform sampling" in page.text
    assert (
        "Uniform sampling from the same offline policies (with-uniform) recommends pi_1, which"
        " returns -10.0: as much."
    ) in [text.replace(MINUS, "-") for text in results["verdict"]["more"]]
    # Not of another seed or with half of each batch online, nor one that is damaged.
    for assignment in ("seed=6", "sampling.online_share=0.5", "deployment.updates=7"):
        before = other.description
        other.describe(assignment)
        assert read_run(made.folder).uniform is None
        other.folder.description.write_text(before.to_toml())
        other.description = before
    assert read_run(made.folder).uniform is not None
    other.folder.results.write_text('{"complete": true, "recommended": {"policy": "x"}}')
    assert read_run(made.folder).uniform is None


def test_a_run_that_goes_on_says_so_far(made: MadeRun) -> None:
    made.folder.evaluation(3).unlink()
    made.folder.deployment(3).unlink()
    assert result(made)[1].startswith("So far: no clear change: the recommended policy, pi_1")
    for k in (1, 2):
        made.folder.evaluation(k).unlink()
        made.folder.deployment(k).unlink()
    assert result(made) == (
        "open",
        "Nothing has been tuned yet: the offline policy returns -20.0.",
    )
    made.folder.evaluation(0).unlink()
    assert result(made) == ("open", "Nothing has been measured yet.")


def test_without_evaluations_the_deployments_tell(made: MadeRun) -> None:
    made.describe("evaluation.episodes=0")
    for k in range(4):
        made.folder.evaluation(k).unlink()
    made.folder.deployment(2).unlink()
    made.deploy(2, [40.0, 42.0])
    assert result(made)[1].startswith("Tuning helped: the recommended policy, pi_1, returns 41.0")
    for k in (1, 2, 3):
        made.folder.deployment(k).unlink()
    made.deploy(1, [30.0, 32.0])
    assert result(made)[1] == "Nothing has been tuned yet: the offline policy returns 31.0."


def test_a_change_is_not_called_improvement(made: MadeRun) -> None:
    assert "improvement" not in report(made)[1].text.lower()


class Terminal(io.StringIO):
    """A standard output that claims to be one."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("last", "code"), [([200.0, 211.0], "32"), ([30.0, 41.0], "31")])
def test_the_first_line_is_coloured_on_a_terminal_and_nowhere_else(
    made: MadeRun, last: list[float], code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made.describe("deployment.keep=last")
    made.evaluate(0, OFFLINE)
    made.evaluate(3, last)
    report(made)
    for name, value in {"TERM": "xterm-256color", "FORCE_COLOR": "1"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("NO_COLOR", raising=False)
    shown = []
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stdout", stream)
        show_summary(RunFolder(made.folder.root))
        shown.append(stream.getvalue())
    lines = "\n".join(summary_lines(made.folder)) + "\n"
    assert shown[0].startswith(f"\x1b[1;{code}mTuning ") and shown[0].count("\x1b") == 2
    assert shown[1] == lines


def test_columns_of_one_unit_have_as_many_decimals() -> None:
    assert columns([1205.93, 12.5], [0.25, None]) == [["1,206", "12"], ["0", NOTHING]]
    assert columns([55.578, 50.66], [0.5963, float("nan")]) == [
        ["55.58", "50.66"],
        ["0.60", NOTHING],
    ]
    assert columns([3, 10]) == [["3", "10"]]
    assert columns([]) == [[]]
