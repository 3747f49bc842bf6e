"""Pictures of the steps of a timeline: the scene, and beside it what happens in numbers."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from PIL import Image

from otc_dist.replay.drawing import Panel, ScenePicture
from otc_dist.replay.offscreen import Offscreen
from otc_dist.replay.timeline import Timeline
from otc_dist.scenes.robots import RobotScene
from otc_dist.terminal.errors import UserError

WIDTH, HEIGHT = 1120, 480  # px; even numbers, as video codecs want
_PANEL = 320  # px
_ROOM = 1.3  # times as high as a robot that stands is what a picture of it shows

Render = Callable[[int], Image.Image]  # of step i of the timeline


@contextmanager
def renderer(timeline: Timeline, title: str) -> Iterator[Render]:
    """Renders the timeline's steps, WIDTH x HEIGHT; robots by MuJoCo, all else drawn here.

    `title` says which episode it is.

    Raises:
        UserError: the environment cannot be drawn, or robots cannot be rendered here.
    """
    scene = timeline.scene
    if scene is None:
        raise UserError(
            f"the states of {timeline.header.team.env_id} do not say what it looks like;"
            " --html shows its actions and rewards"
        )
    panel = Panel(timeline, _PANEL, HEIGHT, title)

    def beside(picture: Image.Image, i: int) -> Image.Image:
        whole = Image.new("RGB", (WIDTH, HEIGHT))
        whole.paste(picture, (0, 0))
        whole.paste(panel.draw(i), (WIDTH - _PANEL, 0))
        return whole

    if not isinstance(scene, RobotScene):
        drawn = ScenePicture(timeline, scene, WIDTH - _PANEL, HEIGHT)
        yield lambda i: beside(drawn.draw(i), i)
        return
    _colour_links(scene)
    positions = scene.positions(timeline.states)
    with Offscreen(scene.model, WIDTH - _PANEL, HEIGHT, _ROOM * scene.top) as offscreen:
        yield lambda i: beside(Image.fromarray(offscreen.render(positions[i])), i)


def _colour_links(scene: RobotScene) -> None:
    """Give each link the colour of the agent that moves it."""
    model = scene.model
    for geom, body in enumerate(model.geom_bodyid.tolist()):
        if body > 0:
            model.geom_matid[geom] = -1
            model.geom_rgba[geom, :3] = np.array(scene.bodies[body - 1].colour) / 255
