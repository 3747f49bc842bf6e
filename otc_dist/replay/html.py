"""`--html OUT.html`: one file that plays a deployment in any browser, without a network."""

import argparse
import base64
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import ArrayLike

from otc_dist.replay.output import claimed
from otc_dist.replay.timeline import Timeline, selected_timeline
from otc_dist.scenes.scene import Scene, agent_colour, choice_colours
from otc_dist.terminal.printable import on_page, say

_SCRIPTS = ("timeline.js", "scene.js", "plots.js", "playback.js")  # in this order one program
_SECONDS = 0.05  # a step, where no scene says how long it takes


def run(arguments: argparse.Namespace) -> int:
    """Write the page of the selected steps and say where it is."""
    out = Path(arguments.html)
    with claimed(out, force=arguments.force, reads=arguments.files) as path:
        page = render(selected_timeline(arguments))
        path.write_text(page, encoding="utf-8")
    say(out)
    return 0


def render(timeline: Timeline) -> str:
    """The page."""
    header = timeline.header
    lead = (
        f"{about(timeline)} · seed {header.seed} · otc_dist {header.versions.get('otc_dist', '?')}"
    )
    if timeline.extent.shortfall is not None:
        lead += f" · {timeline.extent.shortfall}"
    return filled(title(timeline), lead, packed(timeline))


def title(timeline: Timeline) -> str:
    """Of which run and deployment it is."""
    return f"{timeline.header.run}, deployment {timeline.header.deployment}"


def about(timeline: Timeline) -> str:
    """Which part of that it is."""
    steps = f"steps {timeline.numbers[0]:,} to {timeline.numbers[-1]:,}"
    return f"{timeline.header.team.env_id} · {steps} of copy {timeline.copy}"


def filled(title: str, lead: str, packed: Mapping[str, object], *more: str) -> str:
    """The page with this in it, and with `more` of the viewer's scripts."""
    return Template(_part("page.html")).substitute(
        title=on_page(title),
        lead=on_page(lead),
        style=_part("style.css"),
        script="\n".join(map(_part, (*_SCRIPTS, *more))),
        # Within a script element nothing is unescaped, and "</script" would end it.
        timeline=json.dumps(packed, separators=(",", ":")).replace("<", "\\u003c"),
    )


def _part(name: str) -> str:
    return resources.files("otc_dist.replay").joinpath("viewer", name).read_text(encoding="utf-8")


def packed(timeline: Timeline) -> dict[str, object]:
    """The timeline as the viewer reads it: arrays in base64, little-endian, in C order."""
    return {
        "seconds": timeline.scene.seconds if timeline.scene is not None else _SECONDS,
        "numbers": _array(timeline.numbers, "<i4"),
        "episodes": _array(timeline.episodes, "<i4"),
        "names": [timeline.episode(i) for i in _first_steps(timeline)],
        "rewards": _array(timeline.rewards, "<f4"),
        "returns": _array(timeline.returns, "<f4"),
        "exploring": _array(timeline.exploring, "<u1"),
        "agents": [
            {
                "name": agent.name,
                "colour": agent_colour(place),
                "choices": agent.choices,
                "low": agent.action_low,
                "high": agent.action_high,
                "actions": _array(actions, "<f4"),
            }
            for place, agent, actions in zip(
                timeline.places, timeline.agents, timeline.actions, strict=True
            )
        ],
        "choices": choice_colours(
            timeline.choice_names, max((agent.choices for agent in timeline.agents), default=0)
        ),
        "scene": _scene(timeline, timeline.scene) if timeline.scene is not None else None,
    }


def _first_steps(timeline: Timeline) -> list[int]:
    """Where on the timeline an episode begins, or continues after missing steps."""
    new = np.diff(timeline.episodes, prepend=-1) != 0
    new |= np.diff(timeline.numbers, prepend=timeline.numbers[0] - 1) != 1
    return [int(i) for i in np.flatnonzero(new)]


def _scene(timeline: Timeline, scene: Scene) -> dict[str, object]:
    frames, view = timeline.frames(scene), scene.view
    return {
        "view": {
            "centre": view.centre,
            "width": view.width,
            "height": view.height,
            "outline": view.outline,
            "follows": view.follows,
        },
        "bodies": [
            {
                "name": body.name,
                "colour": body.colour,
                "solid": body.solid,
                "capsules": [(*c.start, *c.end, c.radius) for c in body.capsules],
            }
            for body in scene.bodies
        ],
        "choices": scene.choices,
        "poses": _array(frames.poses, "<f4"),
        "levels": _array(frames.levels, "<f4"),
    }


def _array(values: ArrayLike, dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype).tobytes()).decode()
