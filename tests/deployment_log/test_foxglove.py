"""What Foxglove shows of a log says the same as the steps, and never costs one."""

import json
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex

from otc_dist.deployment_log.reader import read_steps
from otc_dist.envs.robot_specs import HOPPER
from otc_dist.envs.robots import load_model
from otc_dist.replay import foxglove as conversion
from otc_dist.transitions import JointStep
from tests.replay.played import play

from .shown import shown

LAYOUT = Path(conversion.__file__).with_name("foxglove_layout.json")


@pytest.fixture(scope="module")
def hops(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[JointStep]]:
    path = tmp_path_factory.mktemp("hops") / "log.mcap"
    return path, play("hopper-3x1", path, 90)


def messages(path: Path, topic: str) -> list[tuple[int, int, Any]]:
    """Time, sequence and content."""
    return [(each.time, each.sequence, each.content) for each in shown(path, topic)]


def test_scalars_are_those_of_the_steps(hops) -> None:
    path, steps = hops
    found = messages(path, "/step")
    with path.open("rb") as stream:
        times = [m.log_time for _, _, m in make_reader(stream).iter_messages("joint_step")]
    assert [time for time, _, _ in found] == times
    total, episode, within = 0.0, 0, 0
    for (_, sequence, said), step in zip(found, steps, strict=True):
        total += float(step.rewards[0][0])
        assert sequence == said["step"] == step.step
        assert (said["episode"], said["episode_step"]) == (episode, within)
        assert said["reward"] == pytest.approx(step.rewards[0][0], rel=1e-5)
        assert said["episode_return"] == pytest.approx(total, rel=1e-5)
        assert said["terminated"] is bool(step.terminated[0])
        for i in range(3):
            agent = said["agents"][f"agent_{i}"]
            assert agent["action_0"] == pytest.approx(step.actions[i][0, 0], rel=1e-5)
            assert agent["reward"] == said["reward"] and agent["exploring"] is False
        within += 1
        if step.terminated[0]:
            total, episode, within = 0.0, episode + 1, 0
    assert episode > 0


def test_frames_are_where_the_robots_links_are(hops) -> None:
    """By the rotation that Foxglove applies to what is fixed to a frame."""
    path, steps = hops
    model = load_model(HOPPER)
    data = mujoco.MjData(model)
    for (time, _, said), step in zip(messages(path, "/transforms"), steps, strict=True):
        data.qpos[:] = step.state[0, 1:7]
        mujoco.mj_forward(model, data)
        frames = {frame.child_frame_id: frame for frame in said.transforms}
        for name in ("torso", "thigh", "leg", "foot"):
            frame, body = frames[name], data.body(name)
            assert frame.timestamp.ToNanoseconds() == time
            assert frame.parent_frame_id == "world"
            at, q = frame.translation, frame.rotation
            assert (at.x, at.y, at.z) == pytest.approx(body.xpos, abs=6e-4)
            turn = np.empty(9)
            mujoco.mju_quat2Mat(turn, np.array([q.w, q.x, q.y, q.z]))
            assert turn == pytest.approx(body.xmat, abs=5e-3)
        assert frames["view"].translation.x == frames["torso"].translation.x


def test_the_scene_is_fixed_to_frames_that_there_are(hops) -> None:
    path, _ = hops
    ((_, sequence, scene),) = messages(path, "/scene")  # links do not change: once is enough
    frames = {t.child_frame_id for t in messages(path, "/transforms")[0][2].transforms}
    assert sequence == 0 and not scene.deletions
    assert {e.frame_id for e in scene.entities} == {"world", *frames} - {"view"}
    (thigh,) = (e for e in scene.entities if e.id == "thigh")
    (cylinder,), (one, other) = thigh.cylinders, thigh.spheres
    geom = load_model(HOPPER).geom("thigh_geom")
    assert cylinder.size.x == one.size.x == pytest.approx(2 * geom.size[0])
    assert cylinder.size.z == pytest.approx(2 * geom.size[1])
    ends = [s.pose.position.z for s in (one, other)]
    assert abs(ends[0] - ends[1]) == pytest.approx(2 * geom.size[1])
    middle = cylinder.pose.position.z
    assert middle == pytest.approx(geom.pos[2]) == pytest.approx(sum(ends) / 2)


def test_units_that_lose_health_are_drawn_anew(tmp_path: Path) -> None:
    """Each time all of them, without the dead: the newest message has to do by itself, and who has
    seen those before takes the dead away.
    """
    path = tmp_path / "log.mcap"
    steps = play("5m_vs_6m", path, 60)
    scenes = messages(path, "/scene")
    assert 1 < len(scenes) < 60
    for _, sequence, scene in scenes:
        health = steps[sequence].state[0, 1:].reshape(4, 11)[2]
        units = [*(f"agent_{i}" for i in range(5)), *(f"enemy_{j}" for j in range(6))]
        there = {unit for unit, left in zip(units, health, strict=True) if left > 0}
        assert {entity.id for entity in scene.entities} == {"ground", *there}
        assert {gone.id for gone in scene.deletions} == {*units} - there
    assert any(scene.deletions for _, _, scene in scenes)


def test_what_is_not_finite_is_left_out(tmp_path: Path, small) -> None:
    """Of a task without a scene there are the scalars."""
    path = small.finish(tmp_path / "log.mcap")
    found = messages(path, "/step")
    assert len(found) == 12 and not messages(path, "/transforms")
    for (_, _, said), step in zip(found, small.steps, strict=True):
        for i, actions in enumerate(step.actions):
            finite = [j for j, x in enumerate(actions[0]) if np.isfinite(x)]
            shown = [key for key in said["agents"][f"agent_{i}"] if key.startswith("action")]
            assert shown == [f"action_{j}" for j in finite]
            assert said["agents"][f"agent_{i}"]["exploring"] is step.exploring[i]


def test_steps_lie_in_chunks_of_their_own(tmp_path: Path, recording) -> None:
    """Whoever reads them decompresses nothing else."""
    path = recording(((40, 9),) * 3, 4, 300).finish(tmp_path / "log.mcap")
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunks: list[ChunkIndex] = summary.chunk_indexes
    channels = [set(chunk.message_index_offsets) for chunk in chunks]
    assert channels.count({1}) > 1 and all(1 not in found for found in channels if found != {1})


@pytest.mark.parametrize("where", ["find", "FoxgloveChannels.write"])
def test_a_picture_that_fails_costs_no_step(
    tmp_path: Path, small, same, monkeypatch, caplog: pytest.LogCaptureFixture, where: str
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(f"otc_dist.deployment_log.foxglove.{where}", fail)
    with caplog.at_level(logging.ERROR):
        path = small.finish(tmp_path / "log.mcap")
    assert "log.mcap will not show all that it could in Foxglove" in caplog.text
    assert all(same(a, b) for a, b in zip(read_steps(path), small.steps, strict=True))


def test_the_layout_shows_what_is_there(tmp_path: Path) -> None:
    """Its topics and fields are those of the largest team; its panels those that it arranges."""
    path = tmp_path / "log.mcap"
    play("5m_vs_6m", path, 2)
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    schemas = {c.topic: summary.schemas[c.schema_id].data for c in summary.channels.values()}
    shown = 0
    for name, panel in layout["configById"].items():
        for series in panel.get("paths", ()):
            topic, *fields = series["value"].split(".")
            if topic.endswith("/tuning"):  # --foxglove adds them
                assert fields in (["alpha"], ["similarity"])
                continue
            schema = json.loads(schemas[topic])
            for field in fields:
                schema = schema["properties"][field]
            assert schema["type"] == "number"
            shown += 1
        if name.startswith("3D!"):
            assert set(panel["topics"]) <= set(schemas)
            assert panel["followTf"] == "view"
    assert shown == 12

    def panels(place: object) -> set[str]:
        if isinstance(place, str):
            return {place}
        return panels(place["first"]) | panels(place["second"])

    assert panels(layout["layout"]) == set(layout["configById"])


def test_foxglove_can_read_the_schemas(tmp_path: Path) -> None:
    """It wants an object's properties, an array's items and everyone's type to be named."""

    def check(schema: dict) -> None:
        if "oneOf" in schema:
            assert all(isinstance(one["const"], int) and one["title"] for one in schema["oneOf"])
        elif schema["type"] == "object":
            for part in schema["properties"].values():
                check(part)
        elif schema["type"] == "array":
            assert schema["items"]["type"] in ("object", "number", "integer", "string")
            check(schema["items"])
        else:
            assert schema["type"] in ("number", "integer", "string", "boolean")

    path = tmp_path / "log.mcap"
    play("5m_vs_6m", path, 2)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    channels = [c for c in summary.channels.values() if c.message_encoding == "json"]
    assert {c.topic for c in channels} == {"/step"}
    for channel in channels:
        check(json.loads(summary.schemas[channel.schema_id].data))


def test_a_deployment_of_which_steps_are_missing(tmp_path: Path, small) -> None:
    """What an episode returned up to there is not known after a gap: it is counted anew."""
    from otc_dist.deployment_log.finishing import write_finished
    from otc_dist.deployment_log.open_log import OpenLog

    whole = small.finish(tmp_path / "whole.mcap")
    out = tmp_path / "gap.mcap"
    with OpenLog(whole) as log:
        header = replace(log.header, run="gap")
        write_finished(out, header, lambda: [*log.blocks(0, 3), *log.blocks(7, 9)], {})
    found = {sequence: said for _, sequence, said in messages(out, "/step")}
    assert list(found) == [0, 1, 2, 7, 8]
    assert found[7]["episode"] > found[2]["episode"] and found[7]["episode_step"] == 0
    assert found[7]["episode_return"] == found[7]["reward"]
