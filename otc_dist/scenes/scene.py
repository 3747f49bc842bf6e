"""What a scene is: flat bodies of capsules that move in a plane.

All our tasks are flat. A robot moves in its sagittal plane (u forward, v up), particles and units
of a skirmish in theirs, seen from above. So a body is some capsules that are fixed to each other,
its pose is (u, v, angle), and a disc is a capsule without length.
"""

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from otc_dist.transitions import Float64

Point = tuple[float, float]  # u, v
Colour = tuple[int, int, int]  # red, green, blue: 0 to 255

# By agent; from the seventh on they begin again.
AGENT_COLOURS: tuple[Colour, ...] = (
    (37, 99, 201),
    (200, 80, 30),
    (23, 130, 106),
    (154, 63, 160),
    (154, 114, 0),
    (24, 138, 178),
)
NOBODYS: Colour = (125, 134, 146)  # what no agent moves
GOAL: Colour = (47, 158, 68)
FOE: Colour = (204, 20, 66)
_IDLE: dict[str, Colour] = {"no-op": (214, 219, 225), "stop": (160, 168, 178)}


def choice_colours(names: Sequence[str], count: int) -> tuple[Colour, ...]:
    """One for each of `count` discrete actions; those that do nothing, as far as `names` say, are
    grey.
    """
    found: list[Colour] = []
    for choice in range(count):
        if choice < len(names) and names[choice] in _IDLE:
            found.append(_IDLE[names[choice]])
            continue
        # Hues a golden angle apart: neighbours differ, and so do many.
        hue, light = (0.61 + 0.381966 * choice) % 1, 0.46 + 0.14 * (choice % 2)
        red, green, blue = colorsys.hls_to_rgb(hue, light, 0.62)
        found.append((round(255 * red), round(255 * green), round(255 * blue)))
    return tuple(found)


def agent_colour(agent: int) -> Colour:
    """The colour that stands for agent number `agent` wherever it is shown."""
    return AGENT_COLOURS[agent % len(AGENT_COLOURS)]


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` of the stretch from `start` to `end`, in its body's frame."""

    start: Point
    end: Point
    radius: float


@dataclass(frozen=True)
class Body:
    """Something that moves as one, or stands. Its name is unique in the scene."""

    name: str
    colour: Colour
    capsules: tuple[Capsule, ...]
    solid: bool = True  # False: a place that others may be in, drawn as its outline


class Frames(NamedTuple):
    """A scene at T moments, with B bodies."""

    poses: Float64  # (T, B, 3): u, v and the angle, counterclockwise, rad
    levels: Float64  # (T, B): 1 whole, 0 gone; between them what is left of its health


@dataclass(frozen=True)
class View:
    """What a picture shows: `width` x `height` around `centre`, or moving with a body.

    `outline` is drawn behind the bodies: the walls of an arena. Where the picture moves with a
    body (`follows`, its number), there is the ground at v = 0 instead, and only u follows.
    """

    centre: Point
    width: float
    height: float
    outline: tuple[Point, ...] = ()
    follows: int | None = None


class Scene(Protocol):
    """What the copies of one environment look like."""

    @property
    def bodies(self) -> tuple[Body, ...]:
        """B bodies, in the order in which they are drawn."""
        ...

    @property
    def view(self) -> View:
        """Which part of the plane to show."""
        ...

    @property
    def seconds(self) -> float:
        """How long a step takes in the task's own time, or what is good to look at."""
        ...

    @property
    def choices(self) -> tuple[str, ...]:
        """What discrete actions are called, by their index; empty where they are continuous."""
        ...

    def frames(self, states: Float64) -> Frames:
        """Where the bodies are in `states` (T, state_size), as `BatchedEnv.state` gives them.

        What is not finite, where a simulator broke off, stays so.
        """
        ...


def disc(radius: float) -> tuple[Capsule, ...]:
    """A body that is a disc around its own origin."""
    return (Capsule((0.0, 0.0), (0.0, 0.0), radius),)
