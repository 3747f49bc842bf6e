"""A recording of single-agent play, as importers read it, and its split into a team's data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.datasets.joint import JointTransitions
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32


@dataclass(frozen=True)
class Recording:
    """T transitions in the order of time, episode after episode.

    `known` is False where the true successor is not known; `next_observations` means nothing
    there.
    """

    observations: Float32  # (T, observation_size)
    actions: Float32  # (T, action_size), of all actuators
    rewards: Float32  # (T,)
    next_observations: Float32  # (T, observation_size)
    known: Bool  # (T,)
    terminated: Bool  # (T,)
    truncated: Bool  # (T,)
    episodes: NDArray[np.int64]  # (T,) ascending
    begun: Bool  # (T,) whether the row's episode is there from its first step
    notes: tuple[str, ...]  # what was assumed or reconstructed, for the card

    def with_notes(self, *notes: str) -> "Recording":
        return replace(self, notes=(*self.notes, *notes))


def numbers(array: NDArray[Any], name: str, shape: tuple[int, ...], source: str) -> Float32:
    """`array` as float32, if it has that shape (-1: any length) and only finite values.

    Raises:
        UserError: it does not, with the place of the first bad value.
    """
    fits = len(array.shape) == len(shape) and all(
        size in (-1, found) for size, found in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise UserError(f"{source}: {name} has shape {array.shape}, not {_text(shape)}")
    if array.dtype.kind not in "fiu":
        raise UserError(f"{source}: {name} holds {array.dtype}, not numbers")
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, and is refused
        converted = np.asarray(array, np.float32)
    if not np.isfinite(converted).all():
        row = int(np.argwhere(~np.isfinite(converted))[0, 0])
        raise UserError(
            f"{source}: {name} has a value that is not finite (NaN or infinity) in row {row}; "
            "fix the file first"
        )
    return converted


def flags(array: NDArray[Any], name: str, length: int, source: str) -> Bool:
    """`array` as bool, if it has `length` values that are 0 or 1. UserError otherwise."""
    if array.shape not in ((length,), (length, 1)):
        raise UserError(f"{source}: {name} has shape {array.shape}, not ({length},)")
    if array.dtype.kind not in "biuf" or not np.isin(array, (0, 1)).all():
        raise UserError(f"{source}: {name} holds values other than 0 and 1")
    return array.reshape(length).astype(np.bool_)


def _text(shape: tuple[int, ...]) -> str:
    return str(tuple("any" if size == -1 else size for size in shape)).replace("'", "")


def joint_sizes(spec: TeamSpec, source: str) -> tuple[int, int]:
    """Observation and joint action size of a team in which everyone sees the same state.

    Raises:
        UserError: agents of this team see different things, so one recording cannot be split.
    """
    sizes = {agent.observation_size for agent in spec.agents}
    if len(sizes) != 1:
        raise UserError(f"{source}: cannot split it for {spec.env_id}, whose agents see parts only")
    return sizes.pop(), sum(agent.action_size for agent in spec.agents)


def split(recording: Recording, spec: TeamSpec) -> tuple[JointTransitions, tuple[str, ...]]:
    """Give each agent its slice of the action vector, and all of them state and reward.

    Transitions whose true successor is not known are dropped, because a wrong s' corrupts the
    matching distance d(s', s'*); actions are clipped to the bounds, as the environment does.

    Returns:
        the team's data, and the recording's notes with those on what was dropped and clipped.
    """
    kept, notes = recording.known, recording.notes
    bounds = np.cumsum([agent.action_size for agent in spec.agents])[:-1]
    actions, said = clipped(np.split(recording.actions, bounds, axis=1), spec)
    notes += said
    if not kept.all():
        notes += (dropped(kept, recording.terminated),)
    observations, successors = recording.observations[kept], recording.next_observations[kept]
    rewards = recording.rewards[kept]
    count = len(spec.agents)
    joint = JointTransitions(
        observations=(observations,) * count,
        actions=tuple(part[kept] for part in actions),
        rewards=(rewards,) * count,
        next_observations=(successors,) * count,
        terminated=recording.terminated[kept],
        truncated=recording.truncated[kept],
        episodes=recording.episodes[kept],
    )
    return joint, notes


def clipped(
    actions: Sequence[Float32], spec: TeamSpec
) -> tuple[tuple[Float32, ...], tuple[str, ...]]:
    """Actions N x (T, action_size) within the agents' bounds, and in words, how many were not."""
    within = tuple(
        np.clip(sent, *np.array((agent.action_low, agent.action_high), np.float32))
        for sent, agent in zip(actions, spec.agents, strict=True)
    )
    moved = [(a != b).any(axis=1) for a, b in zip(actions, within, strict=True)]
    beyond = int(np.any(moved, axis=0).sum())
    if not beyond:
        return within, ()
    return within, (f"{beyond} actions beyond the bounds were clipped, as the environment does",)


def dropped(known: Bool, terminated: Bool) -> str:
    """In words, how many transitions (T,) are left out because their successor is not known."""
    ends = int((~known & terminated).sum())
    text = f"{int((~known).sum())} transitions were dropped: the file lacks their true successor"
    if not ends:
        return text
    remaining = int((terminated & known).sum())
    return f"{text}; {ends} of them terminated, {remaining} that terminated are left" + (
        "" if remaining else ", so learners cannot see that falling ends an episode"
    )


class EpisodeStarts:
    """Which episodes are there from their first step.

    Exports of ours say which steps they are of which log and copy; where one is cut, because steps
    are missing or only a part was exported, what is left becomes an episode that has no beginning.
    Others' episodes are taken to be whole.
    """

    def __init__(self) -> None:
        self._followed: set[tuple[int, int, int]] = set()  # what comes after an episode's end

    def has(self, place: tuple[int, int, int] | None, length: int, ended: bool) -> bool:
        """Whether the next episode, of so many steps, has its beginning.

        Args:
            place: log, copy and step of its first row; None: nothing is said of it.
        """
        if place is None:
            return True
        log, copy, step = place
        if ended:
            self._followed.add((log, copy, step + length))
        return step == 0 or place in self._followed
