"""What Foxglove shows of a deployment: channels in JSON beside the steps' own.

The steps' channel is msgpack, which Foxglove does not display. So a finished log says the main
things once more: the scalars by name, and where the bodies of one copy are. They are made from the
recorded steps, with their times and numbers, after the last step: nothing waits for them, and no
step depends on them. They lie after the steps in chunks of their own, so that a reader of steps
never has to decompress them.
"""

import json
import math
from collections.abc import Iterable, Iterator
from math import cos, sin

import numpy as np
from mcap.writer import Writer

from otc_dist.deployment_log import foxglove_schemas as schemas
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.record import Rows
from otc_dist.scenes.families import find
from otc_dist.scenes.scene import Body, Capsule, Colour, Frames, Scene, View

WORLD = "world"
VIEW = "view"  # the frame that the layout's camera follows
LEVELS = 20  # steps in which a body's level shows
_FAINT = 0.35  # opacity of places; no body that is there is fainter
_GROUND = (-10, 200)  # m
_TRUE = 0xC3  # msgpack's
_MARK = 0.05  # m: half the length of the marks at every metre

Json = dict[str, object]


class FoxgloveChannels:
    """Adds the channels of one copy to a file that is being written.

    `/step` carries scalars, `/transforms` where the bodies are and `/scene` what they look like.
    The plane of a scene stands upright: u is x and v is z. A task without a scene has
    its scalars alone.
    """

    def __init__(self, writer: Writer, header: LogHeader, copy: int = 0) -> None:
        self._writer, self._team, self._copy = writer, header.team, copy
        self._scene = find(header.team)
        self._scalars = self._register("/step", schemas.STEP, schemas.step_schema(header.team))
        if self._scene is not None:
            self._scene_channel = self._register("/scene", schemas.SCENE, schemas.scene_schema())
            self._transforms = self._register(
                "/transforms", schemas.TRANSFORMS, schemas.transforms_schema()
            )
        self._tuning: dict[str, int] = {}
        self._shown: list[int] = []  # the levels of the newest `/scene`
        self._returns = [0.0] * len(self._team.agents)
        self._episode, self._episode_step = 0, 0
        self._next_step: int | None = None

    def _register(self, topic: str, name: str, schema: bytes) -> int:
        number = self._writer.register_schema(name, "jsonschema", schema)
        metadata = {"copy": str(self._copy)}
        return int(self._writer.register_channel(topic, "json", number, metadata=metadata))

    def _add(self, channel: int, log_time: int, step: int, data: str) -> None:
        self._writer.add_message(
            channel_id=channel,
            log_time=log_time,
            publish_time=log_time,
            sequence=step,
            data=data.encode(),
        )

    def write(self, rows: Rows) -> None:
        """Add what belongs to the steps `rows`, which follow those before."""
        copy = self._copy
        frames = self._scene.frames(rows["state"][:, copy]) if self._scene is not None else None
        for t, (step, log_time) in enumerate(
            zip(rows["step"].tolist(), rows["log_time"].tolist(), strict=True)
        ):
            if self._next_step not in (None, step):  # the episode's end is missing
                self._end_episode()
            self._next_step = step + 1
            self._write_scalars(rows[t], step, log_time)
            if self._scene is not None and frames is not None:
                self._write_scene(self._scene, frames, t, step, log_time)

    def _write_scalars(self, row: np.void, step: int, log_time: int) -> None:
        copy, returns, rewards, agents = self._copy, self._returns, 0.0, []
        for i, agent in enumerate(self._team.agents):
            reward = float(row[f"rewards.{i}"][copy])
            rewards += reward
            returns[i] += reward
            actions = row[f"actions.{i}"][copy].tolist()
            numbers = _numbers(
                (
                    ("reward", reward),
                    ("episode_return", returns[i]),
                    *((f"action_{j}", action) for j, action in enumerate(actions)),
                )
            )
            exploring = _flag(row["exploring"][i] == _TRUE)
            agents.append(f'"{agent.name}":{{"exploring":{exploring}{numbers}}}')
        terminated, truncated = bool(row["terminated"][copy]), bool(row["truncated"][copy])
        count = len(agents)
        numbers = _numbers((("reward", rewards / count), ("episode_return", sum(returns) / count)))
        self._add(
            self._scalars,
            log_time,
            step,
            f'{{"step":{step},"episode":{self._episode},"episode_step":{self._episode_step},'
            f'"terminated":{_flag(terminated)},"truncated":{_flag(truncated)}{numbers},'
            f'"agents":{{{",".join(agents)}}}}}',
        )
        self._episode_step += 1
        if terminated or truncated:
            self._end_episode()

    def _end_episode(self) -> None:
        self._episode, self._episode_step = self._episode + 1, 0
        self._returns = [0.0] * len(self._team.agents)

    def _write_scene(self, scene: Scene, frames: Frames, t: int, step: int, log_time: int) -> None:
        levels = np.rint(np.nan_to_num(frames.levels[t]) * LEVELS).astype(int).tolist()
        if levels != self._shown:
            # Whole each time: who jumps into the file is given the newest message alone.
            entities = list(_entities(scene, levels, log_time))
            message = json.dumps({"deletions": [], "entities": entities}, separators=(",", ":"))
            self._add(self._scene_channel, log_time, step, message)
            self._shown = levels
        poses = frames.poses[t].tolist()
        transforms = ",".join(_transforms(scene, poses, log_time))
        self._add(self._transforms, log_time, step, f'{{"transforms":[{transforms}]}}')

    def write_tuning(
        self, agent: str, log_time: int, deployment: int, alpha: float, similarity: float
    ) -> None:
        """Add what Eq. 4 came to for `agent` at a deployment, as of a moment."""
        if agent not in self._tuning:
            self._tuning[agent] = self._register(
                f"/{agent}/tuning", schemas.TUNING, schemas.tuning_schema()
            )
        numbers = _numbers((("alpha", alpha), ("similarity", similarity)))
        message = f'{{"deployment":{deployment}{numbers}}}'
        self._add(self._tuning[agent], log_time, deployment, message)


def _flag(value: bool) -> str:
    return "true" if value else "false"


def _numbers(pairs: Iterable[tuple[str, float]]) -> str:
    """Further members of an object, without those that JSON has no number for.

    Six digits are more than a plot shows; computations read the steps.
    """
    return "".join(f',"{name}":{value:.6g}' for name, value in pairs if math.isfinite(value))


def _time(log_time: int) -> Json:
    seconds, rest = divmod(log_time, 10**9)
    return {"sec": seconds, "nsec": rest}


def _transforms(scene: Scene, poses: list[list[float]], log_time: int) -> Iterator[str]:
    """The bodies' frames and the view's, as JSON, to the millimetre and to a tenth of a degree.

    None for a body that is nowhere.
    """
    seconds, rest = divmod(log_time, 10**9)
    view = scene.view
    u = poses[view.follows][0] if view.follows is not None else view.centre[0]
    for name, pose in (
        *((body.name, pose) for body, pose in zip(scene.bodies, poses, strict=True)),
        (VIEW, [u, view.centre[1], 0.0]),
    ):
        if not all(map(math.isfinite, pose)):
            continue
        x, z, angle = pose
        # In the upright plane, seen from -y, counterclockwise is about -y.
        yield (
            f'{{"timestamp":{{"sec":{seconds},"nsec":{rest}}},"parent_frame_id":"{WORLD}",'
            f'"child_frame_id":"{name}","translation":{{"x":{x:.3f},"y":0,"z":{z:.3f}}},'
            f'"rotation":{{"x":0,"y":{-sin(angle / 2):.3f},"z":0,"w":{cos(angle / 2):.3f}}}}}'
        )


def _entities(scene: Scene, levels: list[int], log_time: int) -> Iterator[Json]:
    yield _entity("ground", WORLD, log_time, lines=[_backdrop(scene.view)])
    for body, level in zip(scene.bodies, levels, strict=True):
        if level > 0:
            opacity = _FAINT + (1 - _FAINT) * level / LEVELS if body.solid else _FAINT
            colour = _colour(body.colour, opacity)
            yield _entity(body.name, body.name, log_time, **_shapes(body, colour))


def _entity(
    name: str,
    frame: str,
    log_time: int,
    *,
    spheres: Iterable[Json] = (),
    cylinders: Iterable[Json] = (),
    lines: Iterable[Json] = (),
) -> Json:
    return {
        "timestamp": _time(log_time),
        "frame_id": frame,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "metadata": [],
        "arrows": [],
        "cubes": [],
        "spheres": list(spheres),
        "cylinders": list(cylinders),
        "lines": list(lines),
        "triangles": [],
        "texts": [],
        "models": [],
    }


def _shapes(body: Body, colour: Json) -> dict[str, list[Json]]:
    spheres: list[Json] = []
    cylinders: list[Json] = []
    for capsule in body.capsules:
        width = 2 * capsule.radius
        for x, z in dict.fromkeys((capsule.start, capsule.end)):
            size = _vector(width, width, width)
            spheres.append({"pose": _pose(x, z, 0.0), "size": size, "color": colour})
        if capsule.start != capsule.end:
            cylinders.append(_cylinder(capsule, colour))
    return {"spheres": spheres, "cylinders": cylinders}


def _cylinder(capsule: Capsule, colour: Json) -> Json:
    """Its axis is its own z, which has to be turned about y."""
    (x, z), (to_x, to_z) = capsule.start, capsule.end
    width = 2 * capsule.radius
    return {
        "pose": _pose((x + to_x) / 2, (z + to_z) / 2, math.atan2(to_x - x, to_z - z)),
        "size": _vector(width, width, math.hypot(to_x - x, to_z - z)),
        "bottom_scale": 1,
        "top_scale": 1,
        "color": colour,
    }


def _backdrop(view: View) -> Json:
    """The walls of the arena, or the ground with a mark at every metre."""
    if view.follows is None:
        kind, points = 1, [*view.outline]
    else:
        first, last = _GROUND
        kind, points = 2, [(float(first), 0.0), (float(last), 0.0)]
        for metre in range(first, last + 1):
            points += [(float(metre), 0.0), (float(metre), -_MARK)]
    return {
        "type": kind,
        "pose": _pose(0.0, 0.0, 0.0),
        "thickness": 2,
        "scale_invariant": True,
        "points": [_vector(x, 0, z) for x, z in points],
        "color": {"r": 0.5, "g": 0.5, "b": 0.5, "a": 1},
        "colors": [],
        "indices": [],
    }


def _vector(x: float, y: float, z: float) -> Json:
    return {"x": round(x, 5), "y": round(y, 5), "z": round(z, 5)}


def _pose(x: float, z: float, about_y: float) -> Json:
    turned = {"x": 0, "y": round(sin(about_y / 2), 5), "z": 0, "w": round(cos(about_y / 2), 5)}
    return {"position": _vector(x, 0, z), "orientation": turned}


def _colour(colour: Colour, opacity: float) -> Json:
    r, g, b = (round(part / 255, 3) for part in colour)
    return {"r": r, "g": g, "b": b, "a": round(opacity, 3)}
