"""Make a finished log of steps: chunked, compressed, indexed, with checksums over all of it."""

import json
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import mcap
from mcap.writer import CompressionType, Writer

import otc_dist
from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.episodes import find_episodes, to_json
from otc_dist.deployment_log.extent import Source, scheduled_steps
from otc_dist.deployment_log.format import DamagedLogError, seal
from otc_dist.deployment_log.foxglove import FoxgloveChannels
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.record import CHANNEL_ID, PAYLOAD_START, Rows
from otc_dist.deployment_log.schema import payload_schema
from otc_dist.system import durable

log = logging.getLogger(__name__)


def write_finished(
    path: Path,
    header: LogHeader,
    blocks: Callable[[], Iterable[Rows]],
    policies: Mapping[str, str],
    *,
    recovered_from: Source | None = None,
) -> None:
    """Write a finished log under its name only when it is whole.

    The steps' payloads stay the same to the byte. Added are `policies` (agent -> digest of the
    policy that acted), the table of episodes, what Foxglove shows and, where steps are missing,
    which there are.

    Args:
        blocks: gives all steps, in order, as often as it is called.
        recovered_from: what the steps are the whole ones of, where they are not all for certain.

    Raises:
        OSError: the disk is full, ...: nothing is left behind.
    """
    binding = header.binding
    with durable.writing(path, ".new") as stream:
        writer = Writer(
            stream,
            chunk_size=fmt.CHUNK_SIZE,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        begin(writer, header)
        ranges: list[list[int]] = []
        written = _write(writer, blocks(), ranges)
        episodes = find_episodes(written, len(header.team.agents))
        _add_pictures(writer, header, blocks(), path)
        writer.add_metadata(fmt.POLICIES, seal(policies, binding))
        writer.add_metadata(fmt.EPISODES, seal({"episodes": to_json(episodes)}, binding))
        if len(ranges) > 1 or (ranges and ranges[0][0] > 0):
            writer.add_metadata(fmt.RANGES, seal({"ranges": json.dumps(ranges)}, binding))
        if recovered_from is not None:
            recovery = _recovery(ranges, header, recovered_from)
            writer.add_metadata(fmt.RECOVERED, seal(recovery, binding))
        writer.finish()  # type: ignore[no-untyped-call]


def _recovery(ranges: list[list[int]], header: LogHeader, source: Source) -> dict[str, str]:
    """What a recovered log says of itself: from what it was recovered, and how much it holds."""
    scheduled = scheduled_steps(header)
    return {
        "from": source,
        "steps": str(sum(high - low for low, high in ranges)),
        "of": "not known" if scheduled is None else str(scheduled),
    }


def _write(writer: Writer, blocks: Iterable[Rows], ranges: list[list[int]]) -> Iterator[Rows]:
    """Write each block's steps and pass it on; `ranges` collects which steps there were."""
    for rows in blocks:
        for row in rows:
            step = int(row["step"])
            if ranges and ranges[-1][1] == step:
                ranges[-1][1] += 1
            else:
                ranges.append([step, step + 1])
            writer.add_message(
                channel_id=CHANNEL_ID,
                log_time=int(row["log_time"]),
                publish_time=int(row["publish_time"]),
                sequence=step,
                data=row.tobytes()[PAYLOAD_START:],
            )
        yield rows


def _add_pictures(writer: Writer, header: LogHeader, blocks: Iterable[Rows], path: Path) -> None:
    """What Foxglove shows, after the steps.

    A deployment cannot be repeated: whatever goes wrong with its picture, its log is finished.
    """
    # The steps' last chunk ends here.
    writer.flush()  # type: ignore[no-untyped-call]
    try:
        channels = FoxgloveChannels(writer, header)
        for rows in blocks:
            channels.write(rows)
    except (OSError, DamagedLogError):
        raise
    except Exception:
        log.exception("%s will not show all that it could in Foxglove", path)


def begin(writer: Writer, header: LogHeader) -> None:
    """What stands before the steps, in the unfinished and in the finished log."""
    entries = seal(header.to_entries())
    layout = header.layout()
    writer.start(fmt.PROFILE, f"otc_dist {otc_dist.__version__}, mcap-python {mcap.__version__}")
    writer.add_metadata(fmt.HEADER, entries)
    schema = writer.register_schema(fmt.SCHEMA, "jsonschema", payload_schema(layout))
    channel = writer.register_channel(fmt.TOPIC, "msgpack", schema, metadata=entries)
    if channel != CHANNEL_ID:
        raise RuntimeError(f"the channel's id is {channel}, not {CHANNEL_ID}")
