"""Writes docs/paper.md: what the paper claims, and what the raw scores in results/paper show.

python docs/paper.py
"""

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

from otc_dist.comparison import spent
from otc_dist.comparison.campaign import verdicts
from otc_dist.comparison.campaign.verdicts import Verdict
from otc_dist.launch.compare import campaign_file
from otc_dist.launch.compare.campaign_file import Campaign
from otc_dist.launch.compare.campaign_results import Results

PAGE = Path(__file__).parent / "paper.md"
SCORES = Path(__file__).parents[1] / "results" / "paper"
CAMPAIGN = "paper-table1"
WIDTH = 110
HEAD = """\
# The paper's tables and figures

<!-- Written by `python docs/paper.py`; tests/test_results.py compares. -->

What *Online Tuning for Offline Decentralized Multi-Agent Reinforcement Learning* shows, run again:
its arms as it writes them, on the same five seeds for all, beside a null arm and this package's
default. One command does all of it, or goes on where it was stopped, and copies the raw scores of
every complete seed to `results/paper` ([what was fixed before the first seed
ran](../results/paper/README.md)):

<!-- short: python -m otc_dist.launch campaign paper-table1 --quick --dry-run -->
```sh
python -m otc_dist.launch campaign paper-table1 --results results/paper
```

From the scores alone, `campaign --tables results/paper --page paper.html` prints every table and
draws the learning curves and alpha, and runs nothing. Data sets are our own ([data](data.md)), not
D4RL's.
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
    results = Results.read(scores) if any(scores.glob("*/description.toml")) else None
    if results is None or not results.found:
        campaign = Campaign.load(campaign_file.find(CAMPAIGN))
        judged = [verdicts.judge(figure, (), campaign.published) for figure in campaign.figures]
        return "\n".join([HEAD, "**Nothing of it has been run yet.**\n", *_claims(judged), TABLE_2])
    seeds = sorted({one.seeds for one in results.found})
    hours = sum(
        one.processor_seconds
        for path in scores.glob("*/seed_*/spent.json")
        for one in spent.kept(path).values()
    )
    parts = [
        HEAD,
        f"Complete so far: {seeds[0]} to {seeds[-1]} seeds of {len(results.found)} comparisons, in"
        f" {hours / 3600:,.0f} hours of one core.\n",
        *_claims(results.judged),
        "## Table 1 and what belongs to it\n",
        "```text",
        *results.together(),
        "```\n",
        TABLE_2,
    ]
    return "\n".join(parts)


def _claims(judged: Sequence[Verdict]) -> list[str]:
    rows = [f"| {one.figure.title} | {one.figure.claim} | {one} |" for one in judged]
    table = ["| | the paper | here |", "| --- | --- | --- |", *rows]
    return ["## What is reproduced\n", *table, "", fill(verdicts.RULE, WIDTH), ""]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
