"""What happened in a run, good or bad, in a sentence that its numbers bear out."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from otc_dist.report import kept
from otc_dist.report.numbers import MINUS, signed
from otc_dist.report.return_statistics import improvement, student_interval
from otc_dist.report.run_data import Evaluation, RunData

Tone = Literal["good", "bad", "open"]

_MOST_PERCENT = 1000.0  # beyond it the offline return is near 0, and a percentage says nothing


@dataclass(frozen=True)
class Verdict:
    """`tone`: of the sentence; "open" where nothing can be said, or nothing has changed."""

    tone: Tone
    sentence: str
    more: tuple[str, ...] = ()


@dataclass(frozen=True)
class Change:
    """What pi_k returns where pi_0 returned `before`, over `episodes` episodes of each.

    `low`, `high`: the 95% interval of the difference; NaN where it is not known.
    """

    policy: int
    value: float
    before: float
    low: float
    high: float
    episodes: int

    @property
    def tone(self) -> Tone:
        """Open where the interval holds 0."""
        return "good" if self.low > 0 else "bad" if self.high < 0 else "open"

    def __str__(self) -> str:
        """`337.0 (-868.9, -72.0 %)`."""
        percent = improvement(self.value, self.before)
        share = percent is not None and abs(percent) <= _MOST_PERCENT
        relative = f", {signed(percent, ' %')}" if share else ""
        return f"{_plain(self.value)} ({signed(self.value - self.before)}{relative})"


def verdict(run: RunData) -> Verdict:
    """Of a run as far as it has come."""
    changes = _greedy(run) or _measured(run)
    if not changes:
        return _before_tuning(run)
    last, chosen = changes[-1], kept.recommended(run)
    policy = int(str(chosen["policy"])) if chosen else last.policy
    tone, sentence = _sentence(changes, policy if chosen else None)
    if not run.complete:
        sentence = f"So far: {sentence[0].lower()}{sentence[1:]}"
    return Verdict(tone, sentence, tuple(_more(run, changes, policy)))


def _sentence(changes: Sequence[Change], recommended: int | None) -> tuple[Tone, str]:
    last = changes[-1]
    chosen = next((one for one in changes if one.policy == recommended), last)
    close = f"; too close for {chosen.episodes} episodes to tell"
    if recommended == 0:
        so = {
            "bad": "Tuning did harm, so the offline policy is recommended",
            "good": "Tuning helped in the end, but the deployments spoke for the offline policy,"
            " which is recommended",
            "open": "Nothing shows that tuning helped, so the offline policy is recommended",
        }[last.tone]
        tail = close if last.tone == "open" else ""
        result = f"it returns {_plain(last.before)}, the last tuned one, pi_{last.policy}, {last}"
        return "bad" if last.tone == "bad" else "open", f"{so}: {result}{tail}."
    which = "recommended" if chosen.policy == recommended else "last tuned"
    so = {"good": "Tuning helped", "bad": "Tuning did harm", "open": "No clear change"}[chosen.tone]
    return chosen.tone, (
        f"{so}: the {which} policy, pi_{chosen.policy}, returns {chosen}, the offline one"
        f" {_plain(chosen.before)}{close if chosen.tone == 'open' else ''}."
    )


def _more(run: RunData, changes: Sequence[Change], policy: int) -> list[str]:
    values = {0: changes[0].before, **{one.policy: one.value for one in changes}}
    last, found = changes[-1], []
    if policy not in (0, last.policy):
        how = {
            "good": "better than the offline one",
            "bad": "worse than the offline one",
            "open": "too close to the offline one to tell",
        }[last.tone]
        found.append(f"The last tuned policy, pi_{last.policy}, returns {last}: {how}.")
    best = max(values, key=lambda k: values[k])
    if best == policy:
        found.append(f"None of the {len(values)} policies returns more in the same episodes.")
    else:
        found.append(
            f"The best of the {len(values)} policies in the same episodes, as is known only"
            f" afterwards, is pi_{best}: {_plain(values[best])}."
        )
    if run.uniform is not None and policy in values:
        ahead = values[policy] - run.uniform.greedy_return
        apart = f"{_plain(abs(ahead))} {'less' if ahead > 0 else 'more'}"
        found.append(
            f"Uniform sampling from the same offline policies ({run.uniform.folder}) recommends"
            f" pi_{run.uniform.policy}, which returns {_plain(run.uniform.greedy_return)}:"
            f" {apart if ahead else 'as much'}."
        )
    return found + _of_data(run)


def _before_tuning(run: RunData) -> Verdict:
    offline = kept.greedy_return(run, 0)
    if offline is None:
        offline = next((one.mean for one in kept.estimates(run) if one.policy == 0), None)
    if offline is None:
        return Verdict("open", "Nothing has been measured yet.")
    when = "was tuned" if run.complete else "has been tuned yet"
    nothing = f"Nothing {when}: the offline policy returns {_plain(offline)}."
    return Verdict("open", nothing, tuple(_of_data(run)))


def _of_data(run: RunData) -> list[str]:
    mean = run.data_return
    return [] if mean is None else [f"The episodes in the data return {_plain(mean)} on average."]


def _greedy(run: RunData) -> list[Change]:
    """By the evaluations; their episodes are the same for all policies, so by pairs."""
    offline = next((one for one in run.evaluations if one.deployment == 0), None)
    if offline is None:
        return []
    return [_paired(one, offline) for one in run.evaluations if one.deployment > 0]


def _paired(mine: Evaluation, offline: Evaluation) -> Change:
    value, before = (sum(one.returns) / len(one.returns) for one in (mine, offline))
    low, high = math.nan, math.nan
    if mine.seeds == offline.seeds and len(mine.returns) == len(offline.returns):
        apart = [a - b for a, b in zip(mine.returns, offline.returns, strict=True)]
        low, high = student_interval(apart)
    return Change(mine.deployment, value, before, low, high, len(mine.returns))


def _measured(run: RunData) -> list[Change]:
    """By what the deployments measured, where nothing was evaluated."""
    found = kept.estimates(run)
    if not found or found[0].policy != 0:
        return []
    first, changes = found[0], []
    for one in found[1:]:
        apart, error = one.mean - first.mean, math.hypot(one.error, first.error)
        low, high = apart - 2 * error, apart + 2 * error
        episodes = min(one.episodes, first.episodes)
        changes.append(Change(one.policy, one.mean, first.mean, low, high, episodes))
    return changes


def _plain(value: float) -> str:
    return f"{value:,.1f}".replace("-", MINUS)
