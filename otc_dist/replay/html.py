"""`--html OUT.html`: one file that plays a deployment in any browser, without a network."""

import argparse
import base64
import json
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import ArrayLike

from otc_dist.replay.output import claimed
from otc_dist.replay.timeline import Tape, selected_tape
from otc_dist.scenes.scene import Scene, agent_colour, choice_colours
from otc_dist.terminal.printable import on_page, say

_SCRIPTS = ("tape.js", "scene.js", "plots.js", "playback.js")  # in this order one program
_SECONDS = 0.05  # a step, where no scene says how long it takes


def run(arguments: argparse.Namespace) -> int:
    """Write the page of the selected steps and say where it is."""
    out = Path(arguments.html)
    with claimed(out, force=arguments.force) as path:
        page = render(selected_tape(arguments))
        path.write_text(page, encoding="utf-8")
    say(out)
    return 0


def render(tape: Tape) -> str:
    """The page."""
    header = tape.header
    steps = f"steps {tape.numbers[0]:,} to {tape.numbers[-1]:,}"
    lead = (
        f"{header.team.env_id} · {steps} of copy {tape.copy} · seed {header.seed}"
        f" · otc_dist {header.versions.get('otc_dist', '?')}"
    )
    if tape.extent.shortfall is not None:
        lead += f" · {tape.extent.shortfall}"
    return Template(_part("page.html")).substitute(
        title=on_page(f"{header.run}, deployment {header.deployment}"),
        lead=on_page(lead),
        style=_part("style.css"),
        script="\n".join(map(_part, _SCRIPTS)),
        # Within a script element nothing is unescaped, and "</script" would end it.
        tape=json.dumps(_packed(tape), separators=(",", ":")).replace("<", "\\u003c"),
    )


def _part(name: str) -> str:
    return resources.files("otc_dist.replay").joinpath("viewer", name).read_text(encoding="utf-8")


def _packed(tape: Tape) -> dict[str, object]:
    """The tape as the viewer reads it: arrays in base64, little-endian, in C order."""
    return {
        "seconds": tape.scene.seconds if tape.scene is not None else _SECONDS,
        "numbers": _array(tape.numbers, "<i4"),
        "episodes": _array(tape.episodes, "<i4"),
        "names": [tape.episode(i) for i in _first_steps(tape)],
        "rewards": _array(tape.rewards, "<f4"),
        "returns": _array(tape.returns, "<f4"),
        "exploring": _array(tape.exploring, "<u1"),
        "agents": [
            {
                "name": agent.name,
                "colour": agent_colour(place),
                "choices": agent.choices,
                "low": agent.action_low,
                "high": agent.action_high,
                "actions": _array(actions, "<f4"),
            }
            for place, agent, actions in zip(tape.places, tape.agents, tape.actions, strict=True)
        ],
        "choices": choice_colours(
            tape.choice_names, max((agent.choices for agent in tape.agents), default=0)
        ),
        "scene": _scene(tape, tape.scene) if tape.scene is not None else None,
    }


def _first_steps(tape: Tape) -> list[int]:
    """Where on the tape an episode begins, or goes on behind steps that are missing."""
    new = np.diff(tape.episodes, prepend=-1) != 0
    new |= np.diff(tape.numbers, prepend=tape.numbers[0] - 1) != 1
    return [int(i) for i in np.flatnonzero(new)]


def _scene(tape: Tape, scene: Scene) -> dict[str, object]:
    frames, view = tape.frames(scene), scene.view
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
