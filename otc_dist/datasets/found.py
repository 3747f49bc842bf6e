"""What an importer makes of others' files, before it has a name among the data sets."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from otc_dist.datasets.card import episode_returns, team_rewards
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.recording import EpisodeStarts, clipped, dropped
from otc_dist.datasets.writing import Provenance
from otc_dist.envs import registry
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float64, choice_problem


@dataclass(frozen=True)
class Found:
    """A team's data, and what their card shall say of them."""

    team: TeamSpec
    data: JointTransitions
    made: Provenance


@dataclass(frozen=True)
class Kept:
    """What is left of a team's rows, and what is said of them all."""

    data: JointTransitions
    returns: Float64  # of the complete episodes, with the rows that are not left
    incomplete: int
    notes: tuple[str, ...]


def team_returns(data: JointTransitions, begun: Bool, env_id: str) -> tuple[Float64, int]:
    """Team returns of the complete episodes, and the number of the others.

    Args:
        begun: whether the row's episode is there from its first step, (T,).
    """
    return episode_returns(
        team_rewards(data.rewards),
        data.terminated,
        data.truncated,
        data.episodes,
        begun,
        registry.time_limit(env_id),
    )


def kept(data: JointTransitions, begun: Bool, known: Bool, team: TeamSpec, source: str) -> Kept:
    """The rows that can be learnt from: the steps that happened and have a known successor.

    Args:
        begun: as in `team_returns`.
        known: whether the row's s' is the true one, (T,).

    Raises:
        UserError: a discrete action that was not available.
    """
    notes: tuple[str, ...] = ()
    happened = np.flatnonzero(~(data.terminated & data.truncated))
    if broken := len(data) - len(happened):
        notes += (f"without {broken} steps whose simulator broke off",)
        data, begun, known = data[happened], begun[happened], known[happened]
    returns, incomplete = team_returns(data, begun, team.env_id)
    if not known.all():
        notes += (dropped(known, data.terminated),)
        data = data[np.flatnonzero(known)]
    for number, agent in enumerate(team.agents):
        if problem := choice_problem(data.of_agent(number), agent.choices):
            raise UserError(f"{source}: {agent.name}: {problem}")
    actions, said = clipped(data.actions, team)
    return Kept(replace(data, actions=actions), returns, incomplete, notes + said)


def begun_episodes(data: JointTransitions, places: Sequence[NDArray[np.integer]] | None) -> Bool:
    """Whether each row's episode is there from its first step, (T,), by `EpisodeStarts`.

    Args:
        data: episode after episode.
        places: log, copy and step of each episode's first row; None: nothing is said of them.
    """
    starts = np.flatnonzero(np.diff(data.episodes, prepend=-1))
    lengths = np.diff(starts, append=len(data))
    if places is None or any(len(place) != len(starts) for place in places):
        return np.ones(len(data), np.bool_)
    ended = (data.terminated | data.truncated)[starts + lengths - 1].tolist()
    before, whole = EpisodeStarts(), []
    rows = zip(*(place.tolist() for place in places), strict=True)
    for (log, copy, step), length, end in zip(rows, lengths.tolist(), ended, strict=True):
        whole.append(before.has((log, copy, step), length, end))
    return np.repeat(np.array(whole, np.bool_), lengths)


def left_out(kind: str, names: Sequence[str], most: int = 8) -> tuple[str, ...]:
    """In words, which parts of others' files, called so, were not taken."""
    if not names:
        return ()
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return (f"{kind} not taken: {', '.join(names[:most])}{more}",)
