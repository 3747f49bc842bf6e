"""The checksums of a finished log's container: of its data as a whole, and of every chunk.

Steps and metadata carry their own, which are checked whenever they are read; these cover also what
other tools read, such as the messages that Foxglove shows.
"""

from pathlib import Path

from mcap.records import Chunk
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.format import DamagedLogError
from otc_dist.deployment_log.open_log import PARSE_ERRORS


def check_container(path: Path) -> int:
    """Read a finished log from end to end; the number of its chunks.

    Raises:
        DamagedLogError: a checksum does not hold, or a record cannot be read.
    """
    chunks = 0
    try:
        with path.open("rb") as stream:
            reader = StreamReader(
                stream,
                emit_chunks=True,
                validate_crcs=True,
                record_size_limit=fmt.MAXIMUM_RECORD,
            )
            for record in reader.records:
                if isinstance(record, Chunk):
                    get_chunk_data_stream(record, validate_crc=True)
                    chunks += 1
    except PARSE_ERRORS as error:
        raise DamagedLogError(path, f"after {chunks} chunks: {error}") from None
    return chunks
