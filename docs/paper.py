"""Writes docs/paper.md: what the paper claims, and what the raw scores in results/paper show; and
docs/paper.html, which draws it, as soon as there are any.

python docs/paper.py
"""

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

from otc_dist.comparison import spent
from otc_dist.comparison.campaign import verdicts
from otc_dist.comparison.campaign.verdicts import Verdict
from otc_dist.launch.compare import campaign_file
from otc_dist.launch.compare.campaign_results import Results, together

PAGE = Path(__file__).parent / "paper.md"
DRAWN = PAGE.with_suffix(".html")
SCORES = Path(__file__).parents[1] / "results" / "paper"
CAMPAIGNS = [path for name, path in campaign_file.shipped().items() if name.startswith("paper-")]
WIDTH = 110
HEAD = """\
# The paper's tables and figures

<!-- Written by `python docs/paper.py`; tests/test_results.py compares. -->

What *Online Tuning for Offline Decentralized Multi-Agent Reinforcement Learning* shows, run again:
its arms as it writes them, on the same five seeds for all, beside a null arm and this package's
defaults. A command does each of these campaigns, or goes on where it was stopped:
"""
COMMAND = """\
It copies the raw scores of every complete seed to `results/paper` ([what was fixed before the first
seed ran](../results/paper/README.md)):

<!-- short: python -m otc_dist.launch campaign paper-figure6c --quick --dry-run -->
```sh
python -m otc_dist.launch campaign paper-figure6c --results results/paper
```

They are several, since a campaign does the first seed of all that it has before the second of any:
Figure 6c, an hour of one core, need not wait for Table 1, fifty-six (`--dry-run` prints them).
From the scores alone, `campaign --tables results/paper --page paper.html` prints every table and
draws the learning curves and alpha, of all that was begun, and runs nothing. Data sets are our own
([data](data.md)), not D4RL's.
"""
TABLE_2 = """\
## Table 2: milliseconds an update

| | BCQ | + d_e | + d_q |
| --- | --- | --- | --- |
| the paper, on a GTX 1080Ti | 11.6 | 14.2 (+22%) | 13.8 (+19%) |
| here, one core | 0.75 | 1.14 (+52%) | 1.61 (+115%) |

`python benchmarks/update.py`, in one run, on Hopper's sizes: compiled updates, OTC by rank, the
paper's rule, each in turns with the others. OTC's share is larger here, of an update that is 15
times shorter; by its own defaults OTC adds 8% at most ([speed](results.md#speed)). Later code has
shorter updates of BCQ; since then the three have been measured on a busy machine only, in vain.
"""


def page(scores: Path = SCORES) -> str:
    """The whole page, in Markdown."""
    campaigns = together(CAMPAIGNS)
    rows = [f"| `{name}` | {one.summary} |" for name, one in campaigns.items()]
    head = [HEAD, "| campaign | |", "| --- | --- |", *rows, "", COMMAND]
    results = _read(scores)
    if results is None:
        claims = [figure for one in campaigns.values() for figure in one.figures]
        judged = [verdicts.judge(figure, (), None) for figure in claims]
        return "\n".join(
            [*head, "**Nothing of it has been run yet.**\n", *_claims(judged), TABLE_2]
        )
    seeds = sorted({one.seeds for one in results.found})
    hours = sum(
        one.processor_seconds
        for path in scores.glob("*/seed_*/spent.json")
        for one in spent.kept(path).values()
    )
    parts = [
        *head,
        f"Complete so far: {seeds[0]} to {seeds[-1]} seeds of {len(results.found)} comparisons, in"
        f" {hours / 3600:,.0f} hours of one core. The figures are [drawn]({DRAWN.name}).\n",
        *_claims(results.judged),
        "## All tables\n",
        "```text",
        *results.together(),
        "```\n",
        TABLE_2,
    ]
    return "\n".join(parts)


def drawn(scores: Path = SCORES) -> str | None:
    """The page of every figure, in HTML; None before anything has been run."""
    results = _read(scores)
    return None if results is None else results.page()


def _read(scores: Path) -> Results | None:
    """What has been run, of all campaigns, and the claims of the others as well."""
    if not any(scores.glob("*/description.toml")):
        return None
    results = Results.read(scores, CAMPAIGNS)
    return results if results.found else None


def _claims(judged: Sequence[Verdict]) -> list[str]:
    rows = [f"| {one.figure.title} | {one.figure.claim} | {one} |" for one in judged]
    table = ["| | the paper | here |", "| --- | --- | --- |", *rows]
    return ["## What is reproduced\n", *table, "", fill(verdicts.RULE, WIDTH), ""]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    if (html := drawn()) is not None:
        DRAWN.write_text(html, encoding="utf-8")
