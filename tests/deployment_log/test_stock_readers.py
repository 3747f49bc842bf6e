"""Other people's MCAP readers understand a log from what the log says about itself."""

import io
import json
from pathlib import Path

import msgpack
import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import CRCValidationError

from .javascript import OPENED, run_script


def check_against_header(messages, header: dict[str, str], expected) -> None:
    """Decode with msgpack and numpy alone, sizes from the header."""
    team, copies = json.loads(header["team"]), int(header["copies"])
    observation_sizes = [agent["observation_size"] for agent in team["agents"]]
    action_sizes = [len(agent["action_low"]) for agent in team["agents"]]
    assert len(messages) == len(expected)
    for message, step in zip(messages, expected, strict=True):
        record = msgpack.unpackb(message.data)
        assert message.sequence == record["step"] == step.step
        for name, sizes in (
            ("observations", observation_sizes),
            ("actions", action_sizes),
            ("next_observations", observation_sizes),
        ):
            for raw, size, array in zip(record[name], sizes, getattr(step, name), strict=True):
                decoded = np.frombuffer(raw, "<f4").reshape(copies, size)
                assert decoded.tobytes() == array.tobytes()
        for raw, array in zip(record["rewards"], step.rewards, strict=True):
            assert np.array_equal(np.frombuffer(raw, "<f4"), array)
        assert np.array_equal(np.frombuffer(record["terminated"], "?"), step.terminated)
        assert np.array_equal(np.frombuffer(record["truncated"], "?"), step.truncated)
        assert record["exploring"] == list(step.exploring)
        assert np.array_equal(np.frombuffer(record["episode_seeds"], "<i8"), step.episode_seeds)
        assert record["state"] == step.state.tobytes()


def test_the_mcap_library_reads_a_finished_log(tmp_path: Path, small) -> None:
    path = small.finish(tmp_path / "log.mcap")
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.channel_message_counts[1] == 12
        assert summary.chunk_indexes[0].compression == "zstd"
        assert reader.get_header().profile == "x-otc-dist"
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        triples = list(reader.iter_messages("joint_step"))

    header = metadata["otc_dist.header"]
    assert header["run"] == "a-run" and header["seed"] == "7" and header["deployment"] == "3"
    assert header["description"] == small.header.description
    assert json.loads(header["versions"])["numpy"] == np.__version__
    assert metadata["otc_dist.policies"]["agent_1"] == "digest of agent_1"
    assert sum(e["length"] for e in json.loads(metadata["otc_dist.episodes"]["episodes"])) == 24
    schema, channel, _ = triples[0]
    assert schema is not None and schema.encoding == "jsonschema"
    assert channel.message_encoding == "msgpack" and channel.metadata == header
    check_against_header([message for _, _, message in triples], header, small.steps)


def test_the_crc_over_all_data_holds(tmp_path: Path, small) -> None:
    path = small.finish(tmp_path / "log.mcap")
    data = bytearray(path.read_bytes())

    def read() -> int:
        stream = io.BytesIO(bytes(data))
        reader = NonSeekingReader(stream, validate_crcs=True)
        return sum(1 for _ in reader.iter_messages("joint_step"))

    assert read() == 12
    data[data.index(b"a-run") + 2] = ord("_")  # outside of the chunks
    with pytest.raises(CRCValidationError):
        read()


def test_the_mcap_library_reads_an_unfinished_log(tmp_path: Path, small) -> None:
    small.write(tmp_path / "log.mcap").close()
    messages, header = [], {}
    with (tmp_path / "log.mcap.partial").open("rb") as stream, pytest.raises(EndOfFile):
        for _, channel, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
            header = channel.metadata
            messages.append(message)
    check_against_header(messages, header, small.steps)


def test_the_schema_describes_every_field(tmp_path: Path, small) -> None:
    path = small.finish(tmp_path / "log.mcap")
    with path.open("rb") as stream:
        schema_record, _, message = next(make_reader(stream).iter_messages("joint_step"))
    assert schema_record is not None
    schema, record = json.loads(schema_record.data), msgpack.unpackb(message.data)
    assert list(schema["properties"]) == schema["required"] == list(record)

    def check(described, value) -> None:
        if isinstance(value, bytes):
            size = np.dtype(described["dtype"]).itemsize * np.prod(described["shape"])
            assert described["type"] == "string" and len(value) == size
        elif isinstance(value, list):
            parts = described.get("prefixItems") or [described["items"]] * len(value)
            for part, item in zip(parts, value, strict=True):
                check(part, item)
        else:
            assert described["type"] == {int: "integer", bool: "boolean"}[type(value)]

    for name, value in record.items():
        check(schema["properties"][name], value)


_SCRIPT = """
import { decode } from "@msgpack/msgpack";

const [, reader] = await opened(process.argv[2]);
const sums = [];
for await (const message of reader.readMessages({ topics: ["joint_step"] })) {
  const channel = reader.channelsById.get(message.channelId);
  const schema = JSON.parse(
    new TextDecoder().decode(reader.schemasById.get(channel.schemaId).data));
  const record = decode(message.data);
  const { shape } = schema.properties.rewards.prefixItems[0];
  const bytes = record.rewards[0];
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const rewards = [];
  for (let copy = 0; copy < shape[0]; copy++) rewards.push(view.getFloat32(4 * copy, true));
  sums.push([message.sequence, record.step, rewards, record.exploring]);
}
console.log(JSON.stringify({ profile: reader.header.profile, sums }));
"""


@pytest.mark.slow
def test_the_javascript_library_reads_a_log(tmp_path: Path, recording) -> None:
    made = recording(((40, 9),) * 3, 4, 200)  # several chunks
    found = json.loads(run_script(OPENED + _SCRIPT, made.finish(tmp_path / "log.mcap")))
    assert found["profile"] == "x-otc-dist"
    assert len(found["sums"]) == 200
    for (sequence, number, rewards, exploring), step in zip(found["sums"], made.steps, strict=True):
        assert sequence == number == step.step
        assert np.array_equal(np.array(rewards, np.float32), step.rewards[0])
        assert exploring == list(step.exploring)
