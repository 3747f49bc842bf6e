"""Other people's viewers open a finished log: read by the libraries that they are made of.

What they are given is compared with the steps in test_foxglove.py.
"""

import json
from pathlib import Path

import pytest
from mcap.reader import make_reader

from otc_dist.deployment_log.finishing import write_finished
from otc_dist.deployment_log.open_log import OpenLog
from tests.replay.played import play

from .javascript import OPENED, run_script
from .shown import shown

STEPS = 20
SCHEMAS = {"/scene": "SceneUpdate", "/transforms": "FrameTransforms"}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One of each kind of scene: a robot, particles, units that die."""
    folder = tmp_path_factory.mktemp("viewers")
    paths = [folder / f"{env_id}.mcap" for env_id in ("hopper-3x1", "navigation", "5m_vs_6m")]
    for path in paths:
        play(path.stem, path, STEPS)
    return paths


def test_rerun_loads_it_and_knows_where_the_frames_are(logs: list[Path], tmp_path: Path) -> None:
    """As an .rrd: an entity for each channel, a transform for each frame and step."""
    chunk = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed")
    for path in logs:
        rrd = tmp_path / f"{path.stem}.rrd"
        chunk.McapReader(path).stream().write_rrd(
            rrd, application_id="otc_dist", recording_id=path.stem
        )
        rows: dict[str, dict[str, int]] = {}
        for part in chunk.RrdReader(rrd).stream():
            if not part.is_static:
                for column in part.to_record_batch().schema.names:
                    of_entity = rows.setdefault(part.entity_path, {})
                    of_entity[column] = of_entity.get(column, 0) + part.num_rows
        assert set(rows) == {"/joint_step", "/step", "/scene", "/transforms"}
        frames = [len(each.content.transforms) for each in shown(path, "/transforms")]
        assert rows["/transforms"]["Transform3D:translation"] == sum(frames)
        assert rows["/transforms"]["Transform3D:child_frame"] == sum(frames) > STEPS
        scenes = len(shown(path, "/scene"))
        assert rows["/scene"]["foxglove.SceneUpdate:message"] == scenes > 0
        assert rows["/joint_step"]["McapMessage:data"] == STEPS


def test_foxglove_s_sdk_has_the_same_schemas_and_encodes_the_same_bytes(logs: list[Path]) -> None:
    """Its own encoder, given what ours has written."""
    sdk = pytest.importorskip("foxglove.messages", reason="foxglove-sdk is not installed")
    path = logs[0]
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        if channel.topic in SCHEMAS:
            ours = summary.schemas[channel.schema_id]
            theirs = getattr(sdk, SCHEMAS[channel.topic]).get_schema()
            assert (ours.name, ours.encoding) == (theirs.name, theirs.encoding)
            assert _fields(ours.data) == _fields(theirs.data)
    for each in shown(path, "/transforms"):
        again = sdk.FrameTransforms(
            transforms=[
                sdk.FrameTransform(
                    timestamp=sdk.Timestamp(frame.timestamp.seconds, frame.timestamp.nanos),
                    parent_frame_id=frame.parent_frame_id,
                    child_frame_id=frame.child_frame_id,
                    translation=sdk.Vector3(x=frame.translation.x, z=frame.translation.z),
                    rotation=sdk.Quaternion(y=frame.rotation.y, w=frame.rotation.w),
                )
                for frame in each.content.transforms
            ]
        )
        assert again.encode() == each.data


def _fields(descriptors: bytes) -> dict[str, list[tuple[object, ...]]]:
    """Fields of every message in a set of files: number, name, kind, whether there are many."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    return {
        f"{file.package}.{message.name}": [
            (field.number, field.name, field.type, field.type_name, field.label)
            for field in message.field
        ]
        for file in FileDescriptorSet.FromString(descriptors).file
        for message in file.message_type
    }


_SCRIPT = """
import { protobufFromBinaryDescriptor } from "@mcap/support";
import Ajv from "ajv";

const ajv = new Ajv({ strict: false });
const text = new TextDecoder();
const counts = {};
for (const name of process.argv.slice(2)) {
  const [file, reader] = await opened(name);
  const readers = {
    json: (schema) => {
      const valid = ajv.compile(JSON.parse(text.decode(schema.data)));
      return (data) => {
        if (!valid(JSON.parse(text.decode(data)))) throw new Error(JSON.stringify(valid.errors));
        return 1;
      };
    },
    protobuf: (schema) => {
      const type = protobufFromBinaryDescriptor(schema.data).lookupType(schema.name);
      return (data) => {
        const message = type.toObject(type.decode(data), { arrays: true });
        return (message.transforms || message.entities).length;
      };
    },
  };
  const reads = new Map();
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    if (!(channel.messageEncoding in readers)) continue;
    if (!reads.has(channel.id)) {
      const schema = reader.schemasById.get(channel.schemaId);
      reads.set(channel.id, readers[channel.messageEncoding](schema));
    }
    counts[channel.topic] = (counts[channel.topic] || 0) + reads.get(channel.id)(message.data);
  }
  await file.close();
}
console.log(JSON.stringify(counts));
"""


@pytest.mark.slow
def test_what_foxglove_and_lichtblick_are_made_of_reads_it(logs: list[Path]) -> None:
    """Protobuf by the schemas in the file; JSON that is valid by them."""
    counts = json.loads(run_script(OPENED + _SCRIPT, *logs))
    assert counts == {
        "/step": len(logs) * STEPS,
        "/transforms": sum(
            len(each.content.transforms) for path in logs for each in shown(path, "/transforms")
        ),
        "/scene": sum(
            len(each.content.entities) for path in logs for each in shown(path, "/scene")
        ),
    }


def test_the_same_steps_give_the_same_bytes(logs: list[Path], tmp_path: Path) -> None:
    for path in logs:
        with OpenLog(path) as log:
            again = tmp_path / path.name
            write_finished(again, log.header, log.blocks, {})
        assert again.read_bytes() == path.read_bytes()
