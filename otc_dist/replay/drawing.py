"""Scenes and panels as pictures, by Pillow."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from otc_dist.replay.timeline import Timeline
from otc_dist.scenes.scene import (
    NOBODYS,
    Body,
    Colour,
    Point,
    Scene,
    agent_colour,
    choice_colours,
)
from otc_dist.transitions import Float64

PAPER, INK, FAINT, GREY = (255, 255, 255), (27, 36, 48), (226, 230, 235), (93, 104, 117)

_FINE = 2  # drawn so many times as large, and made smaller: smooth edges
_MARGIN = 14  # px
_ROW = 21  # px: of an agent's name, and of an action at most
_CHART = 84  # px


class ScenePicture:
    """Draws a scene's bodies from above, or from the side, at moments of a timeline."""

    def __init__(self, timeline: Timeline, scene: Scene, width: int, height: int) -> None:
        self._scene, self._frames = scene, timeline.frames(scene)
        self._size = (width, height)
        view = scene.view
        self._scale = _FINE * min(width / view.width, height / view.height)

    def draw(self, i: int) -> Image.Image:
        """Before step i of the timeline."""
        width, height = (_FINE * side for side in self._size)
        picture = Image.new("RGB", (width, height), PAPER)
        draw = ImageDraw.Draw(picture)
        view, poses = self._scene.view, self._frames.poses[i]
        middle = view.centre[0]
        if view.follows is not None and math.isfinite(poses[view.follows, 0]):
            middle = float(poses[view.follows, 0])

        def pixel(u: float, v: float) -> Point:
            return (
                width / 2 + (u - middle) * self._scale,
                height / 2 - (v - view.centre[1]) * self._scale,
            )

        if view.follows is None:
            walls = [pixel(*corner) for corner in (*view.outline, view.outline[0])]
            draw.line(walls, GREY, 2 * _FINE)
        else:
            level = pixel(0.0, 0.0)[1]
            draw.line([(0, level), (width, level)], GREY, 2 * _FINE)
        levels = self._frames.levels[i].tolist()
        for body, pose, level in zip(self._scene.bodies, poses.tolist(), levels, strict=True):
            if level > 0 and all(map(math.isfinite, pose)):
                self._draw_body(draw, body, pose, level, pixel)
        return picture.resize(self._size, Image.Resampling.BOX)

    def _draw_body(
        self,
        draw: ImageDraw.ImageDraw,
        body: Body,
        pose: list[float],
        level: float,
        pixel: Callable[[float, float], Point],
    ) -> None:
        u, v, angle = pose
        c, s = math.cos(angle), math.sin(angle)
        for capsule in body.capsules:
            radius = capsule.radius * self._scale
            ends = [
                pixel(u + c * a - s * b, v + s * a + c * b) for a, b in (capsule.start, capsule.end)
            ]
            for x, y in ends:
                box = (x - radius, y - radius, x + radius, y + radius)
                if body.solid:
                    draw.ellipse(box, _mixed(body.colour, level))
                else:
                    draw.ellipse(box, outline=body.colour, width=2 * _FINE)
            if body.solid and ends[0] != ends[1]:
                draw.line(ends, _mixed(body.colour, level), round(2 * radius))
            if level < 1:
                x, y = ends[0]
                top = y - radius - 6 * _FINE
                right = x - radius + 2 * radius * level
                draw.rectangle((x - radius, top, right, top + 3 * _FINE), body.colour)


def _mixed(colour: Colour, level: float) -> Colour:
    """Paler, the less is left."""
    share = 0.35 + 0.65 * level
    r, g, b = (round(255 - share * (255 - part)) for part in colour)
    return r, g, b


class Panel:
    """What is written beside the picture: episode, step, reward, return, actions, a plot.

    `title` says why it is this episode that is shown.
    """

    def __init__(self, timeline: Timeline, width: int, height: int, title: str) -> None:
        self._timeline, self._size = timeline, (width, height)
        self._large, self._small = ImageFont.load_default(17), ImageFont.load_default(13)
        self._rewards, self._returns = timeline.rewards.mean(axis=1), timeline.returns.mean(axis=1)
        self._background = Image.new("RGB", self._size, PAPER)
        draw = ImageDraw.Draw(self._background)
        draw.line([(0, 0), (0, height)], FAINT, 1)
        header = timeline.header
        run = _shortened(header.run, width - 2 * _MARGIN, self._small)
        draw.text((_MARGIN, 10), run, GREY, self._small)
        draw.text((_MARGIN, 27), f"deployment {header.deployment}", GREY, self._small)
        draw.text((_MARGIN, 48), title, INK, self._large)
        self._facts = 72 if title else 52  # px, where they begin
        names, count = timeline.choice_names, max(agent.choices for agent in timeline.agents)
        self._choices = choice_colours(names, count)
        self._chart = (_MARGIN, height - _CHART, width - _MARGIN, height - _MARGIN)
        _plot(draw, self._chart, self._returns, timeline.episodes.tolist())
        draw.text((_MARGIN, height - _CHART - 18), "return so far", GREY, self._small)

    def draw(self, i: int) -> Image.Image:
        """At step i of the timeline."""
        timeline, panel = self._timeline, self._background.copy()
        draw = ImageDraw.Draw(panel)
        width, height = self._size
        facts = (
            (timeline.episode(i),),
            (f"step {timeline.numbers[i]:,}", f"return {self._returns[i]:,.2f}"),
        )
        for line, texts in enumerate(facts):
            for column, text in enumerate(texts):
                x = _MARGIN + column * (width - 2 * _MARGIN) // 2
                draw.text((x, self._facts + 24 * line), text, INK, self._large)
        self._draw_agents(draw, i, self._facts + 56, height - _CHART - 24)
        left, top, right, bottom = self._chart
        cursor = left + (right - left) * (i + 0.5) / len(timeline)
        draw.line([(cursor, top - 3), (cursor, bottom + 3)], agent_colour(0), 2)
        return panel

    def _choice(self, action: float) -> str:
        names = self._timeline.choice_names
        known = action.is_integer() and 0 <= action < len(names)
        return names[int(action)] if known else f"choice {action:g}"

    def _draw_agents(self, draw: ImageDraw.ImageDraw, i: int, top: int, bottom: int) -> None:
        """As many as there is room for, and how many there are besides."""
        timeline, right = self._timeline, self._size[0] - _MARGIN
        actions = sum(agent.action_size for agent in timeline.agents)
        row = min(_ROW, max(12, (bottom - top - _ROW * len(timeline.agents)) // actions))
        y = top
        for n, agent in enumerate(timeline.agents):
            if y + _ROW + row * agent.action_size > bottom:
                draw.text((_MARGIN, y), f"and {len(timeline.agents) - n} more", GREY, self._small)
                return
            colour = agent_colour(timeline.places[n])
            draw.ellipse((_MARGIN, y + 4, _MARGIN + 9, y + 13), colour)
            name = agent.name + (" explores" if timeline.exploring[i, n] else "")
            draw.text((_MARGIN + 16, y), name, INK, self._small)
            reward = f"reward {timeline.rewards[i, n]:.3g}"
            draw.text((right, y), reward, GREY, self._small, anchor="ra")
            y += _ROW
            for j, action in enumerate(timeline.actions[n][i].tolist()):
                low, high = agent.action_low[j], agent.action_high[j]
                box = (_MARGIN + 16, y + row // 2 - 4, right - 70, y + row // 2 + 4)
                if agent.choices:
                    draw.rectangle(box, self._choices[int(action)])
                else:
                    _bar(draw, box, action, low, high, colour)
                text = self._choice(action) if agent.choices else f"{action:.3f}"
                middle = y + row // 2
                draw.text((right, middle), text, INK, self._small, anchor="rm")
                y += row


def _shortened(text: str, width: int, font: ImageFont.FreeTypeFont | ImageFont.ImageFont) -> str:
    if font.getlength(text) <= width:
        return text
    while text and font.getlength(text + "…") > width:
        text = text[:-1]
    return text + "…"


def _bar(
    draw: ImageDraw.ImageDraw,
    box: tuple[int, int, int, int],
    value: float,
    low: float,
    high: float,
    colour: Colour,
) -> None:
    """A bar from zero to `value`."""
    draw.rectangle(box, FAINT)
    if not math.isfinite(value):
        return
    left, top, right, bottom = box

    def place(x: float) -> float:
        return left + (right - left) * (min(max(x, low), high) - low) / (high - low)

    start, end = sorted((place(0.0), place(value)))
    draw.rectangle((start, top, end, bottom), colour)


def _plot(
    draw: ImageDraw.ImageDraw,
    box: tuple[int, int, int, int],
    values: Float64,
    episodes: Sequence[int],
) -> None:
    """A curve over all steps, broken where an episode ends."""
    left, top, right, bottom = box
    draw.rectangle(box, outline=FAINT)
    finite = values[np.isfinite(values)]
    if not len(finite):
        return
    low, high = float(finite.min()), float(finite.max())
    points: list[Point] = []
    for i, value in enumerate(values.tolist()):
        if i and episodes[i] != episodes[i - 1] and points:
            draw.line(points, NOBODYS, 1)
            points = []
        if math.isfinite(value):
            share = (value - low) / ((high - low) or 1.0)
            x = left + (right - left) * (i + 0.5) / len(values)
            points.append((x, bottom - 3 - share * (bottom - top - 6)))
    if len(points) > 1:
        draw.line(points, NOBODYS, 1)
