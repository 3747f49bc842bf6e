"""What viewers are shown of a log, read by Foxglove's own libraries."""

import json
from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


class Shown(NamedTuple):
    """A message. Its content is an object of JSON, or a message of the schema in the file."""

    topic: str
    time: int
    sequence: int
    content: Any
    data: bytes


def shown(path: Path, *topics: str) -> list[Shown]:
    """Messages of these topics, or of all but the steps, in the order of time."""

    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is no JSON")

    found, protobuf = [], DecoderFactory()
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(topics or None):
            if channel.message_encoding == "msgpack":
                continue
            if channel.message_encoding == "json":
                content = json.loads(message.data, parse_constant=refuse)
            else:
                decode = protobuf.decoder_for(channel.message_encoding, schema)
                assert decode is not None
                content = decode(message.data)
            found.append(
                Shown(channel.topic, message.log_time, message.sequence, content, message.data)
            )
    return found
