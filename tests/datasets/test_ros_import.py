"""ROS 2 recordings become data sets by a mapping file: whole steps, and no guessed ones."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer

from otc_dist.datasets import store
from otc_dist.datasets.__main__ import main
from otc_dist.datasets.importers import import_files
from otc_dist.datasets.ros_mapping import Mapping
from otc_dist.envs import registry
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError

JOINTS = "string[] name\nfloat64[] position\nfloat64[] velocity"
FLAG, NUMBER, COMMAND = "bool data", "float32 data", "float64[] data"
TYPES = {"/joints": JOINTS, "/fell": FLAG, "/reward": NUMBER, "/image": "string data"}
MAPPING = """
clock = "/joints"
reward = {topic = "/reward", field = "data"}
terminated = {topic = "/fell", field = "data"}
""" + "".join(
    f"""
[agents.agent_{i}]
observation = [{{topic = "/joints", field = "position"}}, {{topic = "/joints", field = "velocity"}}]
action = [{{topic = "/motor_{i}", field = "data[0]"}}]
"""
    for i in range(3)
)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))


@dataclass
class Robot:
    """What a hopper's three motors and its sensors published, in the order of time."""

    messages: list[tuple[str, int, dict[str, Any]]] = field(default_factory=list)
    leave_out: Sequence[tuple[str, int]] = ()  # topic, step

    def seen(self, t: int) -> list[float]:
        return [t + k / 16 for k in range(11)]

    def publish(self, topic: str, time: int, **message: object) -> None:
        self.messages.append((topic, time, message))

    def play(self, steps: int, fall: int = -1) -> "Robot":
        """Clock messages at 0, 100, 200, ...; commands, rewards and flags in between."""
        for t in range(steps + 1):
            seen = self.seen(t)
            self.publish("/joints", 100 * t, name=["a"], position=seen[:5], velocity=seen[5:])
            self.publish("/image", 100 * t + 1, data="x")
            if t == steps:
                break
            for i in range(3):
                self.publish(f"/motor_{i}", 100 * t + 20, data=[9.0])  # a later one counts
                self.publish(f"/motor_{i}", 100 * t + 30 + i, data=[(t + i) / 64])
            self.publish("/reward", 100 * t + 100, data=float(t))  # as late as it may come
            self.publish("/fell", 100 * t + 90, data=t == fall)
        self.messages = [m for m in self.messages if (m[0], m[1] // 100) not in self.leave_out]
        return self

    def write(self, path: Path, types: dict[str, str] = TYPES) -> Path:
        path.parent.mkdir(exist_ok=True, parents=True)
        with path.open("wb") as file:
            writer = Writer(file, compression=CompressionType.ZSTD)
            made = {}
            for topic, time, message in self.messages:
                text = types.get(topic, COMMAND)
                if topic not in made:
                    name = f"test_msgs/msg/Of{topic[1:].replace('_', '').title()}"
                    made[topic] = writer.register_msgdef(name, text)
                writer.write_message(topic, made[topic], message, log_time=time)
            writer.finish()
        return path


def mapped(tmp_path: Path, text: str = MAPPING) -> Path:
    path = tmp_path / "mapping.toml"
    path.write_text(text)
    return path


def test_whole_steps_are_taken_and_episodes_end_where_the_flag_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = Robot()
    path = robot.play(12, fall=4).write(tmp_path / "bag" / "bag_0.mcap")
    flags = ["--name", "mine", "--env", "hopper-3x1", "--mapping", str(mapped(tmp_path))]
    assert main(["import", str(path.parent), *flags]) == 0
    told = capsys.readouterr().out
    assert "11 of 12 steps from a message of /joints on" in told
    assert "1 steps were dropped: they lie between episodes" in told
    assert "topics not taken: /image" in told
    joint = store.load_joint("hopper-3x1/mine")
    kept = [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    for i in range(3):
        assert joint.observations[i].tolist() == [robot.seen(t) for t in kept]
        assert joint.next_observations[i].tolist() == [robot.seen(t + 1) for t in kept]
        assert joint.actions[i][:, 0].tolist() == [(t + i) / 64 for t in kept]
        assert joint.rewards[i].tolist() == kept
    assert joint.terminated.nonzero()[0].tolist() == [4] and not joint.truncated.any()
    assert joint.episodes.tolist() == [0] * 5 + [1] * 6


def test_the_mapping_in_the_docs_is_one(tmp_path: Path) -> None:
    page = Path(__file__).parents[2] / "docs" / "data.md"
    text = page.read_text().partition("```toml\n")[2].partition("```")[0]
    mapping = Mapping.read(mapped(tmp_path, text), registry.team_spec("hopper-1x3"))
    assert str(mapping.agents["agent_0"].observation[1]) == "angular_velocity.z of /imu"


def test_a_recording_in_several_files_is_one(tmp_path: Path) -> None:
    robot = Robot().play(9)
    early = Robot([m for m in robot.messages if m[1] < 450])
    late = Robot([m for m in robot.messages if m[1] >= 450])
    late.write(tmp_path / "bag" / "bag_10.mcap")
    early.write(tmp_path / "bag" / "bag_9.mcap")
    card = import_files([tmp_path / "bag"], "mine", "hopper-3x1", mapping=mapped(tmp_path))
    assert card.transitions == 9 and card.incomplete_episodes == 1
    assert set(card.recipe) == {"bag_9.mcap", "bag_10.mcap", "mapping.toml"}


@pytest.mark.parametrize(
    ("topic", "kept", "note"),
    [  # a reward of 300 is of step 2
        ("/motor_1", [0, 1, 2, 4, 5], "1 steps were dropped: an action is missing"),
        ("/reward", [0, 1, 3, 4, 5], "1 steps were dropped: a reward is missing"),
    ],
)
def test_a_step_without_an_action_or_a_reward_is_dropped_and_told(
    tmp_path: Path, topic: str, kept: list[int], note: str
) -> None:
    path = Robot(leave_out=[(topic, 3)]).play(6, fall=5).write(tmp_path / "a.mcap")
    card = import_files([path], "mine", "hopper-3x1", mapping=mapped(tmp_path))
    joint = store.load_joint("hopper-3x1/mine")
    assert note in card.notes and joint.rewards[0].tolist() == kept
    # What follows the gap is another episode, without its beginning.
    gap = int(np.flatnonzero(np.diff(kept) > 1)[0])
    assert joint.episodes.tolist() == [0] * (gap + 1) + [1] * (4 - gap)
    assert (card.episodes, card.incomplete_episodes) == (0, 2)


def test_what_was_not_seen_before_the_first_steps_costs_them(tmp_path: Path) -> None:
    text = MAPPING.replace(
        '{topic = "/joints", field = "velocity"}', '{topic = "/imu", field = "data"}'
    )
    robot = Robot().play(4)
    for t in (1, 2, 3, 4):
        robot.publish("/imu", 100 * t - 50, data=robot.seen(t)[5:])
    card = import_files(
        [robot.write(tmp_path / "a.mcap")], "mine", "hopper-3x1", mapping=mapped(tmp_path, text)
    )
    assert "1 steps were dropped: an observation is missing" in card.notes
    joint = store.load_joint("hopper-3x1/mine")
    assert joint.observations[2].tolist() == [robot.seen(t) for t in (1, 2, 3)]


def refusal(path: Path, mapping: Path, env_id: str = "hopper-3x1") -> str:
    with pytest.raises(UserError) as caught:
        import_files([path], "mine", env_id, mapping=mapping)
    assert "\n" not in str(caught.value)
    return str(caught.value)


BAD_MAPPINGS = [
    ("clock", "is no TOML"),
    (MAPPING.replace("agent_2", "agent_9"), "but the agents of hopper-3x1 are"),
    (MAPPING.replace('reward = {topic = "/reward", field = "data"}', ""), "has no reward"),
    (MAPPING.replace('"data[0]"', '"__class__"'), "is no mapping: agents.agent_0.action.0.field"),
    (MAPPING.replace('"data[0]"', '"data[3]"'), "it is too short"),
    (MAPPING.replace('"data[0]"', '"date"'), "/motor_0 has no field date"),
    (MAPPING.replace('field = "velocity"', 'field = "name"'), "name of /joints holds no numbers"),
    (MAPPING.replace('field = "velocity"', 'field = "position"'), "shape (4, 10), not (any, 11)"),
    (MAPPING.replace("/motor_1", "/motor_7"), "has no message of /motor_7; there are /image"),
    (MAPPING.replace('"/fell"', '"/reward"'), "holds values other than 0 and 1"),
    (
        MAPPING.replace(
            "[agents.agent_0]", '[agents.agent_0]\nlegals = [{topic = "/a", field = "b"}]'
        ),
        "continuous: no legals",
    ),
]


@pytest.mark.parametrize(("text", "message"), BAD_MAPPINGS)
def test_a_mapping_that_does_not_fit_is_refused_in_one_line(
    tmp_path: Path, text: str, message: str
) -> None:
    path = Robot().play(4).write(tmp_path / "a.mcap")
    assert message in refusal(path, mapped(tmp_path, text))
    assert not list((tmp_path / "cache").rglob("*.safetensors"))


def bomb(path: Path) -> None:
    """A chunk that is said to hold a gigabyte."""
    builder = RecordBuilder()
    Chunk("zstd", zstandard.compress(bytes(2**20)), 0, 0, 0, 2**30).write(builder)
    path.write_bytes(path.read_bytes()[:8] + builder.end())


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 4] ^= 1
    path.write_bytes(content)


DAMAGE: list[tuple[Callable[[Path], object], str]] = [
    (lambda path: path.write_bytes(b"hello"), "cannot be read"),
    (lambda path: path.write_bytes(path.read_bytes()[:900]), "cannot be read"),
    (lambda path: path.unlink(), "no MCAP file"),
    (flipped, "cannot be read"),
    (bomb, "is to inflate to 1,073,741,824 bytes"),
]


@pytest.mark.parametrize(("damage", "message"), DAMAGE)
def test_a_damaged_recording_is_refused_in_one_line(
    tmp_path: Path, damage: Callable[[Path], object], message: str
) -> None:
    path = Robot().play(4).write(tmp_path / "a.mcap")
    damage(path)
    assert message in refusal(path, mapped(tmp_path))


def test_values_and_times_that_cannot_be_are_refused(tmp_path: Path) -> None:
    robot = Robot().play(4)
    robot.messages[0][2]["position"][2] = np.nan
    message = refusal(robot.write(tmp_path / "a.mcap"), mapped(tmp_path))
    assert "observation of agent_0 has a value that is not finite" in message
    twice = Robot().play(4)
    twice.messages.append(twice.messages[0])
    message = refusal(twice.write(tmp_path / "b.mcap"), mapped(tmp_path))
    assert "two messages of /joints have the same time" in message
    grows = Robot().play(4)
    joints = [message for topic, _, message in grows.messages if topic == "/joints"]
    joints[3]["position"] = [0.0] * 9
    message = refusal(grows.write(tmp_path / "c.mcap"), mapped(tmp_path))
    assert "position of /joints has 9 numbers in message 3, and 5 in the first one" in message
    assert "with --env" in refusal(tmp_path / "a.mcap", mapped(tmp_path), "")
    both = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for paths, level, message in ((both, "mine", "for one recording"), (both[:1], "", "--name")):
        with pytest.raises(UserError, match=message):
            import_files(paths, level, "hopper-3x1", mapping=mapped(tmp_path))


def test_without_the_library_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Robot().play(4).write(tmp_path / "a.mcap")
    monkeypatch.setitem(sys.modules, "mcap_ros2.decoder", None)
    assert install("ros2") in refusal(path, mapped(tmp_path))
