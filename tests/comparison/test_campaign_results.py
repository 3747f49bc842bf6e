"""Several data sets together: pooled numbers by hand, beside what is published, and verdicts."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.comparison.campaign import page, pooled, tables, verdicts
from otc_dist.comparison.campaign.found import Found, folders, read
from otc_dist.comparison.campaign.pooled import last
from otc_dist.comparison.campaign.published import Figure, Published
from otc_dist.comparison.collected import Collected
from otc_dist.comparison.judgement import recommended
from otc_dist.comparison.scores import Evaluation, Run, best_of
from otc_dist.launch.compare import campaign_file
from otc_dist.launch.compare.campaign_file import Campaign
from otc_dist.run.measured_returns import Measured
from otc_dist.terminal.errors import UserError

# A task whose normalised score is a hundredth of its return, and one that has none.
SCORED, PLAIN = "scored-2/random", "plain-2/random"


class Scored(Collected):
    def normalise(self, value: float) -> float | None:
        return value / 100 if self.env_id == "scored-2" else None


def run(arm: str, seed: int, *means: float) -> Run:
    """Of pi_0 .. pi_K, each deployment measured as high as its policies return."""
    evaluations = [Evaluation([m - 1, m + 1], [5, 5], {}) for m in means]
    measured: list[Measured | None] = [Measured(m, 1.0, 9) for m in means[:-1]]
    return Run(arm, seed, "", evaluations, measured=measured, horizon=5, best=best_of(measured))


def found(part: str, dataset: str, **returns: Sequence[Sequence[float]]) -> Found:
    """Returns of pi_0 .. pi_K, of seeds 0, 1, ... of each arm."""
    arms = {name.replace("_", "-"): of_arm for name, of_arm in returns.items()}
    runs = {
        arm: [run(arm, seed, *means) for seed, means in enumerate(of_arm)]
        for arm, of_arm in arms.items()
    }
    return Found(f"{dataset}-{part}", part, Scored("t", dataset.partition("/")[0], dataset, runs))


def after(*gains: float, first: float = 1000.0) -> list[list[float]]:
    """Runs of one deployment that gain so many normalised points."""
    return [[first, first + 100 * gain] for gain in gains]


ONE = found("a", SCORED, ours=after(1, 3), uniform=after(0, 2), uniform_null=after(1, 1))
TWO = found("a", "scored-2/medium", ours=after(5, 9), uniform=after(5, 6), uniform_null=after(6, 5))


def test_gains_are_in_a_unit_that_data_sets_share() -> None:
    assert pooled.gains(ONE, "ours", last) == {0: 1.0, 1: 3.0}
    plain = found("a", PLAIN, uniform=[[-50.0, -25.0], [0.0, 10.0]])
    assert pooled.gains(plain, REFERENCE, last) == {0: 25.0, 1: 10.0}
    two = found("a", SCORED, uniform=[[100.0, 300.0, 200.0]])
    assert pooled.gains(two, REFERENCE, recommended) == {0: 2.0}  # pi_1's, not pi_2's
    assert pooled.gains(two, REFERENCE, last) == {0: 1.0}


def test_interquartile_means_leave_out_a_quarter_of_all_runs_together() -> None:
    estimate = pooled.iqm([ONE, TWO], "ours", last)
    assert estimate is not None and estimate.value == (3 + 5) / 2  # of 1, 3, 5, 9
    # Seeds are resampled within a data set: the extremes are 1, 1, 5, 5 and 3, 3, 9, 9.
    assert (estimate.low, estimate.high) == (3, 6)
    alone = found("a", SCORED, uniform=after(1))
    single = pooled.iqm([alone], REFERENCE, last)
    assert single is not None and (single.value, str(single)) == (1, "+1.0")
    assert pooled.iqm([ONE, alone], "ours", last) is None


def test_the_probability_of_improvement_counts_pairs_of_runs_and_ties_as_half() -> None:
    better = pooled.improving([ONE, TWO], "ours")
    # 1 and 3 against 0 and 2: three of four. 5 and 9 against 5 and 6: half, lost, won, won.
    assert better is not None and better.value == pytest.approx((3 / 4 + 2.5 / 4) / 2)
    assert 0 <= better.low < better.value < better.high <= 1
    same = pooled.improving([ONE, TWO], REFERENCE)
    assert same is not None and same.value == pytest.approx(0.5)


def test_a_difference_of_several_data_sets_is_paired_by_seed() -> None:
    difference = pooled.difference([ONE, TWO], "ours", REFERENCE)
    assert difference is not None and difference.values == [(1 + 0) / 2, (1 + 3) / 2]
    other = found("a", SCORED, ours=after(1), uniform=after(0))
    fewer = pooled.difference([TWO, other], "ours", REFERENCE)
    assert fewer is not None and fewer.seeds == [0]
    assert pooled.difference([TWO, other], NULL, REFERENCE) is None


PUBLISHED = Published(
    source="somewhere",
    parts={"a": {"scored-2/medium": {"ours": (70.0, 5.0), "uniform": (20.0, 4.0)}}},
)


def test_ours_stand_beside_what_is_published_in_its_order() -> None:
    returned = [[100.0, 150.0, 90.0]]
    default = found("z", TWO.dataset, uniform=returned, uniform_null=after(2, 2))
    elsewhere = found("figure", PLAIN, uniform=returned, uniform_null=returned)
    heads = tables.beside_published([default, ONE, TWO, elsewhere], PUBLISHED)
    assert [" ".join(column) for column in zip(*heads[:2], strict=True)][1:] == [
        *("a ours", "a uniform", "a uniform-null"),
        *("z uniform", "z recommended", "z uniform-null"),
    ]
    assert heads[2:] == [
        [TWO.dataset, "70.0 ± 28.3", "55.0 ± 7.1", "55.0 ± 7.1", "-10.0", "50.0", "20.0 ± 0.0"],
        ["published", "70.0 ± 5.0", "20.0 ± 4.0", "", "", "", ""],
        [SCORED, "20.0 ± 14.1", "10.0 ± 14.1", "10.0 ± 0.0", "-", "-", "-"],
        ["published", "", "", "", "", "", ""],
    ]
    assert tables.beside_published([elsewhere], PUBLISHED) == []
    assert "published" not in "\n".join(tables.text([elsewhere], PUBLISHED))
    assert "what is published" not in page.page("x", [elsewhere], [], PUBLISHED)


def test_a_part_has_a_table_of_every_measure() -> None:
    shown = dict(tables.of_part([ONE, TWO]))
    assert [rows[0][0] for rows in shown.values()] == [*[""] * 5, "2 data sets"]
    gains = [row for title, rows in shown.items() if title == "gain, last" for row in rows]
    assert gains[:2] == [
        ["", "seeds", "ours", "uniform", "uniform-null"],
        [SCORED, "2", "2.0 ± 1.4", "1.0 ± 1.4", "1.0 ± 0.0"],
    ]
    minus = next(rows for title, rows in shown.items() if title.startswith("gain, last, minus"))
    assert minus[2][2:4] == ["+1.5 [+0.0, +3.0]", "-"]
    together = list(shown.values())[-1]
    assert together[1][0] == "ours" and together[1][1] == "+4.0 [+3.0, +6.0]"
    assert together[2][4:] == ["-", "-", "-"] and together[3][0] == NULL
    text = "\n".join(tables.text([ONE, TWO], None))
    assert "a: gain, recommended\n" in text and "published" not in text


STEADY = (0.0, 0.1, -0.1)  # what chance does in seeds 0, 1, 2
FIGURE = Figure(
    title="Figure 9", claim="it helps", parts=("a",), better=("ours",), than=("uniform",)
)


def judged(
    ours: Sequence[float],
    published: Mapping[str, float] | None = None,
    null: Sequence[float] = STEADY,
    uniform: Sequence[float] = (0.0, 0.0, 0.0),
) -> verdicts.Verdict:
    one = found("a", SCORED, ours=after(*ours), uniform=after(*uniform), uniform_null=after(*null))
    printed = {arm: (mean, 1.0) for arm, mean in (published or {}).items()}
    beside = Published(source="x", parts={"a": {SCORED: printed}}) if printed else None
    return verdicts.judge(FIGURE, [one], beside)


@pytest.mark.parametrize(
    ("ours", "published", "null", "word"),
    [
        ((5.0, 5.1, 5.2), None, STEADY, verdicts.REPRODUCED),
        ((5.0, 5.1, 5.2), None, (9.0, 9.1, 9.2), verdicts.UNDECIDED),  # chance does as much
        ((-5.0, -5.1, -5.2), None, STEADY, verdicts.NOT_REPRODUCED),
        ((0.0, 0.2, -0.1), None, STEADY, verdicts.UNDECIDED),
        # A gain of 50% of our 1,000 would be 5 points, which is above the whole interval.
        ((0.0, 0.2, -0.1), {"ours": 60, "uniform": 10}, STEADY, verdicts.NOT_REPRODUCED),
        ((0.0, 9.0, -3.0), {"ours": 60, "uniform": 10}, STEADY, verdicts.UNDECIDED),
        ((1.0, 1.1, 1.2), {"ours": 60, "uniform": 10}, STEADY, verdicts.REPRODUCED),
        ((0.0, 0.2, -0.1), {"ours": 60}, STEADY, verdicts.UNDECIDED),  # of one arm only
        ((5.0,), None, STEADY, verdicts.UNDECIDED),  # one seed has no interval
    ],
)
def test_a_claim_is_judged_by_one_rule(
    ours: Sequence[float], published: Mapping[str, float] | None, null: Sequence[float], word: str
) -> None:
    one = judged(ours, published, null)
    assert one.word == word
    assert str(one).startswith(f"{word.capitalize()}: ours minus uniform ")
    assert ("(published: +5.0)" in one.why) == (published is not None and len(published) == 2)
    assert "the null arm minus uniform" in one.why and "1 data set, 3 seeds" in one.why


def test_what_was_not_run_is_said_and_a_figure_holds_only_with_all_its_claims() -> None:
    elsewhere = FIGURE.model_copy(update={"parts": ("b",)})
    assert str(verdicts.judge(elsewhere, [ONE], None)) == "Not run."
    without = FIGURE.model_copy(update={"than": ("uniform", "balanced")})
    assert verdicts.judge(without, [ONE], None).word == verdicts.NOT_RUN
    other = FIGURE.model_copy(update={"datasets": ("scored-2/medium",)})
    assert [one.dataset for one in verdicts.judge(other, [ONE, TWO], None).shown] == [TWO.dataset]
    both = FIGURE.model_copy(update={"better": ("ours", "theirs")})
    arms = {"uniform": after(0, 0, 0), "uniform_null": after(*STEADY), "ours": after(5, 5.1, 5.2)}
    for theirs, word in {
        (5.0, 5.1, 5.2): verdicts.REPRODUCED,
        (0.0, 9.0, -3.0): verdicts.UNDECIDED,
        (-5.0, -5.1, -5.2): verdicts.NOT_REPRODUCED,
    }.items():
        one = found("a", SCORED, **arms, theirs=after(*theirs))
        assert verdicts.judge(both, [one], None).word == word


def test_where_something_is_published_other_data_sets_do_not_count() -> None:
    sentences = [str(verdicts.judge(FIGURE, [ONE, TWO], one)) for one in (None, PUBLISHED)]
    assert sentences == [
        "Undecided: ours minus uniform +1.2 [+0.5, +2.0], by t [-8.3, +10.8]; by chance, the null"
        " arm minus uniform, +0.0 [-1.0, +1.0]; 2 data sets, 2 seeds.",
        "Undecided: ours minus uniform +1.5 [+0.0, +3.0], by t [-17.6, +20.6] (published: +5.0);"
        " by chance, the null arm minus uniform, +0.0 [-1.0, +1.0]; 1 data set, 2 seeds.",
    ]


def test_the_page_shows_every_figure_with_its_claim_and_what_became_of_it() -> None:
    none = FIGURE.model_copy(update={"title": "Figure 10", "parts": ("b",)})
    judged = [verdicts.judge(figure, [ONE, TWO], PUBLISHED) for figure in (FIGURE, none)]
    shown = page.page("Campaign: x", [ONE, TWO], judged, PUBLISHED)
    sections = shown.split("<section>")
    nine, ten = (next(s for s in sections if s.startswith(f"<h2>Figure {n}<")) for n in (9, 10))
    assert "<p>Undecided</p><p>ours minus uniform" in nine and "The claim: it helps" in nine
    assert nine.count("<svg") == 2 and "<svg" not in ten
    assert SCORED in nine and TWO.dataset in nine and "<p>Not run</p></div>" in ten
    assert "a quick look" not in shown and "somewhere" in shown
    assert "This is a quick look." in page.page("x", [ONE], [], None, "a quick look")


def test_a_figure_draws_returns_where_a_task_has_no_score_and_arms_that_are_not_judged() -> None:
    arms = {name: [[502.0, 501.0], [503.0, 507.0]] for name in ("ours", "uniform", "uniform_null")}
    figure = FIGURE.model_copy(update={"beside": ("mine",)})

    def drawn(one: Found) -> str:
        return page.page("x", [one], [verdicts.judge(figure, [one], None)], None).split("<table")[0]

    plain, scored = drawn(found("a", PLAIN, **arms)), drawn(found("a", SCORED, **arms))
    ticks = ">505<"
    assert ">return<" in plain and ">gain over pi_0<" not in plain and ticks in plain
    assert ">gain over pi_0<" in scored and ">return<" not in scored and ticks not in scored
    assert ">mine<" not in plain and ">mine<" in drawn(found("a", PLAIN, mine=after(0, 1), **arms))


def test_a_campaign_s_folder_says_its_parts(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="not the folder of a campaign"):
        folders(tmp_path)
    (tmp_path / "t-random-a-b" / "seed_00").mkdir(parents=True)
    description = 'name = "t"\n[env]\nid = "hopper-3x1"\n[dataset]\nname = "hopper-3x1/random"\n'
    (tmp_path / "t-random-a-b" / "description.toml").write_text(description)
    assert read(folders(tmp_path)) == []
    run(REFERENCE, 0, 1.0, 2.0).write(tmp_path / "t-random-a-b" / "seed_00" / "uniform.json")
    (one,) = read(folders(tmp_path))
    assert (one.part, one.dataset, one.seeds) == ("a-b", "hopper-3x1/random", 1)


def test_the_paper_s_numbers_are_of_data_and_arms_that_its_first_table_has() -> None:
    campaign = Campaign.load(campaign_file.find("paper-table1"))
    published = campaign.published
    assert published is not None
    assert {len(published.parts[part]) for part in ("bcq", "awac")} == {9, 8}
    assert published.of("awac", "halfcheetah-2x3/random") == {}
    cells = [value for part in published.parts.values() for of in part.values() for value in of]
    assert len(cells) == 3 * 17
    means = [of["paper-embedding"][0] for of in published.parts["awac"].values()]
    assert np.mean(means) == pytest.approx(71.0625)
    for one in campaign.comparisons(quick=True):
        part = one.name.rpartition("-")[2]
        assert set(published.of(part, one.base.dataset.name)) <= set(one.arms)


PAPER = [name for name in campaign_file.shipped() if name.startswith("paper-")]


@pytest.mark.parametrize("name", PAPER)
def test_the_paper_s_claims_are_of_arms_that_its_campaigns_have(name: str) -> None:
    campaign = Campaign.load(campaign_file.find(name))
    claimed = {part for figure in campaign.figures for part in figure.parts}
    assert campaign.seeds == "20..24" and claimed == {*campaign.parts} - {"default"}
    for one in campaign.comparisons(quick=True):
        (part,) = (key for key in campaign.parts if one.name.endswith(f"-{key}"))
        for figure in campaign.figures:
            assert part not in figure.parts or {*figure.arms, *figure.beside} <= {*one.arms}


def test_no_two_campaigns_of_the_paper_have_a_part_of_the_same_name() -> None:
    """They lie in one folder, where a claim is of a part by its name."""
    parts = [part for name in PAPER for part in Campaign.load(campaign_file.find(name)).parts]
    assert len(parts) == len({*parts})
