"""The checksums of a finished log's container: of its data as a whole, and of every chunk.

Steps and metadata carry their own, which are checked whenever they are read; these cover also what
other tools read, such as the messages that Foxglove shows.
"""

from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from otc_dist.deployment_log import chunks
from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.format import DamagedLogError
from otc_dist.deployment_log.open_log import PARSE_ERRORS, OpenLog


def check_container(log: OpenLog) -> int:
    """Read a finished log from end to end; the number of its chunks.

    Raises:
        DamagedLogError: a checksum does not hold, or a record cannot be read.
    """
    count = 0
    try:
        with log.path.open("rb") as stream:
            reader = StreamReader(
                stream,
                emit_chunks=True,
                validate_crcs=True,
                record_size_limit=fmt.MAXIMUM_RECORD,
            )
            for record in reader.records:
                if isinstance(record, Chunk):
                    chunks.contents(record, log.layout.size)
                    count += 1
    except PARSE_ERRORS as error:
        raise DamagedLogError(log.path, f"after {count} chunks: {error}") from None
    return count
