import re
from pathlib import Path

import pytest

from otc_dist.comparison import arms as arms_of
from otc_dist.comparison.arms import (
    ANALYSES,
    KNOWN,
    NULL,
    ORACLE,
    PERFECT,
    REFERENCE,
    USUAL,
    describe,
    parse_arms,
    parse_seeds,
)
from otc_dist.comparison.meanings import MEANINGS
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.description import Description
from otc_dist.launch.compare import command as compare
from otc_dist.launch.run import command as run_command
from otc_dist.terminal.errors import UserError


def test_the_reference_and_the_null_arm_are_always_among_the_arms() -> None:
    assert list(parse_arms("otc-value")) == ["otc-value", REFERENCE, NULL]
    assert list(parse_arms("uniform,online-only")) == [REFERENCE, "online-only", NULL]


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_arms_are_the_same_whatever_online_data_a_description_adds(
    base: Description, share: float
) -> None:
    """An arm's name says what its batches are; `rlpd` alone adds online data."""
    description = base.with_assignments(
        *("sampling.name=uniform", f"sampling.online_share={share}", "deployment.transitions=400")
    )
    for arm, assignments in (KNOWN | ANALYSES).items():
        sampling = describe(description, assignments, 0).sampling.model_dump()
        assert sampling["online_share"] == (0.5 if arm == "rlpd" else 0.0), arm


def test_no_usual_arm_needs_a_q(base: Description) -> None:
    without = base.with_assignments("algorithm.name=bremen", "sampling.candidates=512")
    arms_of.check(without, parse_arms(",".join(USUAL)))
    with pytest.raises(UserError, match="arm otc-value: "):
        arms_of.check(without, parse_arms("otc-value"))


def test_an_unknown_arm_is_answered_with_the_nearest() -> None:
    with pytest.raises(UserError, match="did you mean 'otc-embedding'"):
        parse_arms("otc-embeding,uniform")
    with pytest.raises(UserError, match="no arm"):
        parse_arms(" , ")


def test_an_arm_of_ones_own() -> None:
    found = parse_arms("uniform", ["mild=sampling.name=otc,sampling.alpha=0.5"])
    assert found["mild"] == ("sampling.name=otc", "sampling.alpha=0.5")


@pytest.mark.parametrize(
    "text",
    ["mild", "mild=", "=sampling.alpha=1", "uniform=sampling.alpha=1", "a/b=sampling.alpha=1"],
)
def test_a_bad_arm_of_ones_own_is_refused(text: str) -> None:
    with pytest.raises(UserError, match="--arm"):
        parse_arms("uniform", [text])


@pytest.mark.parametrize(
    ("text", "seeds"),
    [("0..3", (0, 1, 2, 3)), ("5", (5,)), ("0,1,5", (0, 1, 5)), ("0..2,7, 1", (0, 1, 2, 7))],
)
def test_seeds(text: str, seeds: tuple[int, ...]) -> None:
    assert parse_seeds(text) == seeds


@pytest.mark.parametrize("text", ["", "a", "3..1", "-1", "0..", "0-4"])
def test_bad_seeds_are_one_clear_line(text: str) -> None:
    with pytest.raises(UserError, match=r"write 0\.\.9"):
        parse_seeds(text)


def test_known_arms_share_the_offline_policy_but_for_one_that_is_about_it(
    base: Description, tmp_path: Path
) -> None:
    base = base.with_assignments("deployment.transitions=400")  # enough for p-values
    arms_of.check(base, KNOWN)
    folder = ComparisonFolder(tmp_path)
    described = {name: describe(base, a, 3) for name, a in KNOWN.items()}
    places = {n: arms_of.offline_files(folder, base, d).root for n, d in described.items()}
    own = [name for name, place in places.items() if place != folder.seed(3).root]
    assert own == ["typical-offline"]
    assert len({description.digest() for description in described.values()}) == len(KNOWN)


@pytest.mark.parametrize(
    ("assignment", "expected"),
    [
        ("evaluation.episodes=3", "may not change evaluation"),
        ("dataset.name=random", "may not change dataset"),
        ("env.copies=8", "may not change env"),
        ("deployment.count=1", r"may not change deployment\.count"),
    ],
)
def test_an_arm_that_changes_what_all_have_in_common_is_refused(
    base: Description, assignment: str, expected: str
) -> None:
    with pytest.raises(UserError, match=f"arm mine: an arm {expected}"):
        arms_of.check(base, {"mine": (assignment,)})


def test_what_ends_a_run_otherwise_than_others_is_refused(base: Description) -> None:
    for assignment in ("deployment.confirm=true", "deployment.floor=3", "deployment.approve=true"):
        with pytest.raises(UserError, match="is for single runs"):
            arms_of.check(base.with_assignments(assignment), parse_arms("uniform"))


def test_every_arm_is_explained_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(MEANINGS) == set(KNOWN) | set(ANALYSES)
    helps = {}
    for command in (compare, run_command):
        with pytest.raises(SystemExit):
            command.main(["--help"])
        helps[command] = capsys.readouterr().out
    for name, meaning in MEANINGS.items():
        line = re.compile(rf"^  {name} +{re.escape(meaning)}$", re.M)
        assert line.search(helps[compare])
        assert bool(line.search(helps[run_command])) == (name in KNOWN)


def test_a_single_run_takes_an_arm(base: Description) -> None:
    assert arms_of.of_single_run("rlpd") == KNOWN["rlpd"]
    with pytest.raises(UserError, match="did you mean 'otc-embedding'"):
        arms_of.of_single_run("otc-embeding")
    with pytest.raises(UserError, match="arm perfect looks at all agents' data"):
        arms_of.of_single_run("perfect")


def test_an_arm_that_changes_how_pi_0_is_trained_has_its_own(
    base: Description, tmp_path: Path
) -> None:
    folder = ComparisonFolder(tmp_path)
    arms_of.check(base, {"greedy": ("algorithm.discount=0.5",)})
    places = {
        name: arms_of.offline_files(folder, base, describe(base, assignments, 3)).root
        for name, assignments in {
            "uniform": KNOWN[REFERENCE],
            "value": KNOWN["otc-value"],
            "greedy": ("algorithm.discount=0.5",),
            "longer": ("offline.updates=61",),
            "greedy and corrected": ("algorithm.discount=0.5", *KNOWN["otc-value"]),
        }.items()
    }
    assert places["uniform"] == places["value"] == folder.seed(3).root
    assert places["greedy"] == places["greedy and corrected"]
    assert len({places["uniform"], places["greedy"], places["longer"]}) == 3
    assert places["greedy"].is_relative_to(folder.seed(3).root)


def test_an_arm_of_ones_own_takes_no_analysis_name() -> None:
    assert set(parse_arms("perfect,oracle")) == {PERFECT, ORACLE, REFERENCE, NULL}
    with pytest.raises(UserError, match="perfect is an arm already"):
        parse_arms("uniform", ["perfect=sampling.name=uniform"])


def test_the_null_arm_differs_from_the_reference_by_its_minibatches_only(base: Description) -> None:
    null = describe(base, KNOWN[NULL], 0).model_dump()
    reference = describe(base, KNOWN[REFERENCE], 0).model_dump()
    assert {key for key in null if null[key] != reference[key]} == {"minibatch_key"}
