"""A part of a log as arrays over its steps: what pictures of it are made of."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.deployment_log.extent import Extent
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import LogSummary, summarise
from otc_dist.replay.output import note_shortfall
from otc_dist.replay.selection import Selection, select
from otc_dist.scenes.families import find
from otc_dist.scenes.scene import Frames, Scene
from otc_dist.spec import AgentSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32, Float64

_ENDINGS = {1: "st", 2: "nd", 3: "rd"}  # of ordinal numbers


@dataclass(frozen=True)
class Timeline:
    """T steps of one copy and the N agents that are shown, in order; some may be missing between.

    Attributes:
        extent: of the log that they are from.
        places: which of the team's agents they are.
        numbers: (T,), of the steps.
        episodes: (T,), which of the log's episodes a step belongs to, as `--episode` counts them.
        ordinals: (T,), which of the copy's own episodes that is, counted from 1.
        states: (T, state_size), before the steps.
        rewards: (T, N).
        returns: (T, N), from the beginning of the episode up to and with the step.
        actions: N x (T, action_size), as they were sent.
        exploring: (T, N).
        ended: (T,), whether the episode ended with the step.
    """

    header: LogHeader
    extent: Extent
    copy: int
    places: tuple[int, ...]
    scene: Scene | None
    numbers: NDArray[np.int64]
    episodes: NDArray[np.int64]
    ordinals: NDArray[np.int64]
    states: Float64
    rewards: Float64
    returns: Float64
    actions: tuple[Float32, ...]
    exploring: Bool
    ended: Bool

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def agents(self) -> tuple[AgentSpec, ...]:
        """The agents that are shown."""
        return tuple(self.header.team.agents[place] for place in self.places)

    @property
    def choice_names(self) -> tuple[str, ...]:
        """What discrete actions are called, by their index; empty where that is not known."""
        return self.scene.choices if self.scene is not None else ()

    def episode(self, i: int) -> str:
        """Which episode step i of the timeline belongs to: `copy 0, its 2nd episode`."""
        number = int(self.ordinals[i])
        ending = "th" if number % 100 in (11, 12, 13) else _ENDINGS.get(number % 10, "th")
        return f"copy {self.copy}, its {number}{ending} episode"

    def frames(self, scene: Scene) -> Frames:
        """Where the bodies are before each step."""
        return scene.frames(self.states)


def selected_timeline(arguments: argparse.Namespace) -> Timeline:
    """What the command line asks for.

    Raises:
        UserError: more than one file, or there are no such steps.
    """
    if len(arguments.files) > 1:
        raise UserError(f"a picture is of one FILE, not of {len(arguments.files)}")
    with OpenLog(arguments.files[0]) as log:
        summary = summarise(log)
        selection = select(arguments, summary)
        if selection.start == selection.stop:
            raise UserError(f"{log.path} has no steps to show")
        note_shortfall(summary)
        return _read(log, summary, selection)


def highlights(arguments: argparse.Namespace) -> list[tuple[str, Timeline]]:
    """The best and the worst episode by their return, each with what it is called; or the one part
    that the command line asks for, called "".

    Of those that ended, or, where none has, of all.

    Raises:
        UserError: as `selected_tape`.
    """
    if arguments.steps is not None or arguments.episode is not None or len(arguments.files) > 1:
        return [("", selected_timeline(arguments))]
    with OpenLog(arguments.files[0]) as log:
        summary = summarise(log)
        selection = select(arguments, summary)
        whole = [one for one in summary.episodes if one.whole and (one.terminated or one.truncated)]
        shown = selection.indices(log.header.team.names)
        ranked = sorted(
            whole or summary.episodes, key=lambda one: sum(one.returns[i] for i in shown)
        )
        if not ranked:
            raise UserError(f"{log.path} has no steps to show")
        note_shortfall(summary)
        if len(ranked) == 1:
            chosen = {"the only episode": ranked[0]}
        else:
            chosen = {f"best of {len(ranked)} episodes": ranked[-1]}
            chosen[f"worst of {len(ranked)} episodes"] = ranked[0]
        parts = {
            name: replace(selection, start=one.start, stop=one.start + one.length, copy=one.copy)
            for name, one in chosen.items()
        }
        return [(name, _read(log, summary, part)) for name, part in parts.items()]


def _read(log: OpenLog, summary: LogSummary, selection: Selection) -> Timeline:
    copy, scene = selection.copy or 0, find(log.header.team)
    episodes = {n: one.start for n, one in enumerate(summary.episodes) if one.copy == copy}
    return read_timeline(log, episodes, selection, scene)


def read_timeline(
    log: OpenLog, episodes: Mapping[int, int], selection: Selection, scene: Scene | None
) -> Timeline:
    """The selected steps of the selected copy, or of the first one.

    What lies before is read only as far back as the beginning of the episode, for its return.

    Args:
        episodes: those of that copy, in order: number in the log -> first step.
        scene: that of its team.

    Raises:
        DamagedLogError: a step is damaged.
    """
    copy = selection.copy or 0
    of_copy, starts = (np.array([*part], np.int64) for part in (episodes, episodes.values()))
    before = int(np.searchsorted(starts, selection.start, "right")) - 1
    begin = int(starts[before]) if before >= 0 else selection.start

    team = log.header.team
    places = tuple(selection.indices(team.names))
    columns = _columns(log, places, begin, selection.stop, copy)
    numbers = columns["step"].astype(np.int64)
    which = np.searchsorted(starts, numbers, "right") - 1
    rewards = np.stack([columns[f"rewards.{place}"] for place in places], 1).astype(np.float64)
    wanted = numbers >= selection.start
    return Timeline(
        header=log.header,
        extent=log.extent,
        copy=copy,
        places=places,
        scene=scene,
        numbers=numbers[wanted],
        episodes=of_copy[which[wanted]],
        ordinals=which[wanted] + 1,
        states=columns["state"][wanted],
        rewards=rewards[wanted],
        returns=_running(rewards, which)[wanted],
        actions=tuple(columns[f"actions.{place}"][wanted] for place in places),
        exploring=columns["exploring"][wanted][:, list(places)],
        ended=(columns["terminated"] | columns["truncated"])[wanted],
    )


def _columns(
    log: OpenLog, places: tuple[int, ...], start: int, stop: int, copy: int
) -> dict[str, NDArray[Any]]:
    """Fields of the steps, those of copies of one copy: (T, ...)."""
    of_copy = ["state", "terminated", "truncated"]
    of_copy += [f"{field}.{place}" for field in ("rewards", "actions") for place in places]
    parts = []
    for rows in log.blocks(start, stop):
        part = {name: np.array(rows[name][:, copy]) for name in of_copy}
        part["step"] = np.array(rows["step"])
        part["exploring"] = log.layout.exploring(rows)
        parts.append(part)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _running(rewards: Float64, which: NDArray[np.int64]) -> Float64:
    """Sums of the rewards (T, N) within each episode up to and with the step."""
    bounds = [0, *(np.flatnonzero(np.diff(which)) + 1).tolist(), len(which)]
    parts = [np.cumsum(rewards[low:high], axis=0) for low, high in pairwise(bounds)]
    return np.concatenate(parts)
