"""A campaign as one self-contained page: every figure of a publication, and all tables."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from otc_dist.comparison import charts
from otc_dist.comparison.arms import NULL
from otc_dist.comparison.campaign import tables, verdicts
from otc_dist.comparison.campaign.found import Found
from otc_dist.comparison.campaign.published import Published
from otc_dist.comparison.campaign.verdicts import NOT_REPRODUCED, REPRODUCED, Verdict
from otc_dist.comparison.colours import colours
from otc_dist.comparison.judgement import returns
from otc_dist.report import html
from otc_dist.report.return_statistics import Spread
from otc_dist.report.svg import Series, line_chart

_TONES = {REPRODUCED: "good", NOT_REPRODUCED: "bad"}
_WIDTH, _HEIGHT = 320.0, 240.0  # px, of a small chart
CURVES = (
    "Gain over pi_0 by deployment, in normalised score, or the return where a task has none: mean"
    " over seeds, bands ± one standard deviation."
)


def page(
    title: str,
    found: Sequence[Found],
    judged: Sequence[Verdict],
    published: Published | None,
    label: str = "",
) -> str:
    """The HTML document. `label` is shown where it is no real result."""
    done = f"{len(found)} comparison{'' if len(found) == 1 else 's'} with complete seeds"
    source = "" if published is None else f"; published: {published.source}"
    notices = [html.notice(f"This is {label}.", "Sizes are far below a run's.")] if label else []
    rule = html.section("The rule", html.note(verdicts.RULE)) if judged else ""
    parts = [*notices, _beside(found, published), rule, *map(_figure, judged), *_tables(found)]
    return html.page(title, f"{done}{source}", parts)


def _figure(one: Verdict) -> str:
    why = [one.why] if one.why else []
    said = html.verdict(_TONES.get(one.word, "open"), one.word.capitalize(), why)
    claim = html.note(f"The claim: {one.figure.claim}")
    if not one.shown:
        return html.section(one.figure.title, said, claim)
    arms = [*one.figure.arms, *one.figure.beside, NULL]
    curves = html.charts(_curves(shown, arms) for shown in one.shown)
    alphas = "".join(_alphas(shown, arms) for shown in one.shown) if one.figure.alpha else ""
    return html.section(one.figure.title, said, claim, curves, html.note(CURVES), alphas)


def _curves(one: Found, arms: Sequence[str]) -> str:
    """Of one data set, of the arms that it has."""
    by_arm = colours(arms)
    return line_chart(
        [_curve(one, arm, by_arm) for arm in arms if one.runs(arm)],
        title=one.dataset,
        x_label="deployment",
        y_label="gain over pi_0" if one.scored else "return",
        width=_WIDTH,
        height=_HEIGHT,
    )


def _curve(one: Found, arm: str, by_arm: Mapping[str, int]) -> Series:
    values = np.array(
        [
            [one.gain(x, of[0]) if one.scored else x for x in of]
            for of in map(returns, one.runs(arm).values())
        ]
    )
    found = [Spread.of(column) for column in values.T]
    low, high = zip(*(spread.band for spread in found), strict=True)
    x, means = list(range(len(found))), [spread.mean for spread in found]
    return Series(arm, x, means, low, high, "band", False, by_arm[arm], arm == NULL)


def _alphas(one: Found, arms: Sequence[str]) -> str:
    shown = charts.alpha({arm: list(one.runs(arm).values()) for arm in arms})
    return html.note(f"alpha, {one.dataset}") + shown


def _beside(found: Sequence[Found], published: Published | None) -> str:
    beside = [] if published is None else tables.beside_published(found, published)
    if not beside:
        return ""
    parts, heads, *rows = beside
    named = [" ".join(filter(None, pair)) for pair in zip(parts, heads, strict=True)]
    return html.section("Ours and what is published", html.table(named, rows))


def _tables(found: Sequence[Found]) -> Iterator[str]:
    """A section a part."""
    for part, several in tables.parts(found).items():
        shown = []
        for title, rows in tables.of_part(several):
            shown += [html.note(title), html.table(rows[0], rows[1:])]
        yield html.section(part, *shown, html.note(tables.NOTE))
