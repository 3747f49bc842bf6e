"""What viewers show of a deployment: channels beside the steps' own.

The steps' channel is msgpack, which no viewer displays. So a finished log says the main things once
more: the scalars by name, in JSON, and what the bodies of one copy look like and where they are, in
Foxglove's own Protobuf, which Foxglove, Lichtblick and Rerun draw. They are made from the recorded
steps, with their times and numbers, after the last step: nothing waits for them, and no step
depends on them. They lie after the steps in chunks of their own, so that a reader of steps never
has to decompress them.
"""

import math
from collections.abc import Iterable, Iterator
from itertools import repeat

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from otc_dist.deployment_log import foxglove_schemas as schemas
from otc_dist.deployment_log.foxglove_scene import LEVELS, Placing, scene_update
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.record import Rows
from otc_dist.scenes.families import find
from otc_dist.transitions import Float64

_TRUE = 0xC3  # msgpack's

Picture = tuple[tuple[int, SceneUpdate | FrameTransforms], ...]  # channels, and what is for them


class FoxgloveChannels:
    """Adds the channels of one copy to a file that is being written.

    `/step` carries scalars, `/transforms` where the bodies are and `/scene` what they look like.
    A task without a scene has its scalars alone.
    """

    def __init__(self, writer: Writer, header: LogHeader, copy: int = 0) -> None:
        self._writer, self._team, self._copy = writer, header.team, copy
        self._scalars = self._json_channel("/step", schemas.STEP, schemas.step_schema(header.team))
        self._scene = find(header.team)
        if self._scene is not None:
            self._placing = Placing(self._scene)
            self._looks = self._channel("/scene", "protobuf", register_schema(writer, SceneUpdate))
            self._transforms = self._channel(
                "/transforms", "protobuf", register_schema(writer, FrameTransforms)
            )
        self._tuning: dict[str, int] = {}
        self._shown: list[int] = []  # the levels of the newest `/scene`
        self._returns = [0.0] * len(self._team.agents)
        self._episode, self._episode_step = 0, 0
        self._next_step: int | None = None

    def _json_channel(self, topic: str, name: str, schema: bytes) -> int:
        return self._channel(
            topic, "json", self._writer.register_schema(name, "jsonschema", schema)
        )

    def _channel(self, topic: str, encoding: str, schema: int) -> int:
        metadata = {"copy": str(self._copy)}
        return int(self._writer.register_channel(topic, encoding, schema, metadata=metadata))

    def _add(self, channel: int, log_time: int, step: int, data: bytes) -> None:
        self._writer.add_message(
            channel_id=channel,
            log_time=log_time,
            publish_time=log_time,
            sequence=step,
            data=data,
        )

    def write(self, rows: Rows) -> None:
        """Add what belongs to the steps `rows`, which follow those before."""
        numbers, times = rows["step"].tolist(), rows["log_time"].tolist()
        pictures = self._pictures(rows["state"][:, self._copy], times)
        for row, step, log_time, picture in zip(rows, numbers, times, pictures, strict=True):
            if self._next_step not in (None, step):  # the episode's end is missing
                self._end_episode()
            self._next_step = step + 1
            self._write_scalars(row, step, log_time)
            for channel, message in picture:
                self._add(channel, log_time, step, message.SerializeToString(deterministic=True))

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
            f'"agents":{{{",".join(agents)}}}}}'.encode(),
        )
        self._episode_step += 1
        if terminated or truncated:
            self._end_episode()

    def _end_episode(self) -> None:
        self._episode, self._episode_step = self._episode + 1, 0
        self._returns = [0.0] * len(self._team.agents)

    def _pictures(self, states: Float64, times: list[int]) -> Iterator[Picture]:
        """What is to be seen at each step, by channel; of a task without a scene nothing."""
        scene = self._scene
        if scene is None:
            yield from repeat((), len(times))
            return
        poses, levels = scene.frames(states)
        shown = np.rint(np.nan_to_num(levels) * LEVELS).astype(int).tolist()
        frames = self._placing.frames(poses).tolist()
        for log_time, of_bodies, placed in zip(times, shown, frames, strict=True):
            transforms = (self._transforms, self._placing.transforms(placed, log_time))
            if of_bodies == self._shown:
                yield (transforms,)
                continue
            # Whole each time: who jumps into the file is given the newest message alone.
            yield (self._looks, scene_update(scene, of_bodies, log_time)), transforms
            self._shown = of_bodies

    def write_tuning(
        self, agent: str, log_time: int, deployment: int, alpha: float, similarity: float
    ) -> None:
        """Add what Eq. 4 came to for `agent` at a deployment, as of a moment."""
        if agent not in self._tuning:
            self._tuning[agent] = self._json_channel(
                f"/{agent}/tuning", schemas.TUNING, schemas.tuning_schema()
            )
        numbers = _numbers((("alpha", alpha), ("similarity", similarity)))
        message = f'{{"deployment":{deployment}{numbers}}}'
        self._add(self._tuning[agent], log_time, deployment, message.encode())


def _flag(value: bool) -> str:
    return "true" if value else "false"


def _numbers(pairs: Iterable[tuple[str, float]]) -> str:
    """Further members of an object, without those that JSON has no number for.

    Six digits are more than a plot shows; computations read the steps.
    """
    return "".join(f',"{name}":{value:.6g}' for name, value in pairs if math.isfinite(value))
