"""What a chunk of a log inflates to: never more than a chunk of ours can hold, whatever it says.

A few bytes of Zstandard can stand for gigabytes, and neither the size that a chunk declares nor the
one that its frame declares need be true. So a declared size that is too large is refused before
anything is inflated, and inflating stops at what may come.
"""

import zlib

import zstandard
from mcap.records import Chunk

LARGEST = 4 * 2**20  # bytes of a chunk beside one step: ours hold 256 KiB, other tools' up to this
_LARGEST_WINDOW = 2**23  # bytes that a frame may ask for beside its content; ours ask for less
_PIECE = 2**16  # bytes salvaged at once


def contents(chunk: Chunk, step: int) -> bytes:
    """The records of a chunk, inflated.

    Args:
        step: bytes of the record of one step.

    Raises:
        ValueError, ZstdError: it declares more than a chunk can hold, does not hold what it
            declares, or is not compressed as ours are.
    """
    size, most = chunk.uncompressed_size, LARGEST + step
    if size > most:
        raise ValueError(f"a chunk is to inflate to {size:,} bytes, and none holds {most:,}")
    if chunk.compression == "zstd":
        decompressor = zstandard.ZstdDecompressor(max_window_size=max(_LARGEST_WINDOW, most))
        with decompressor.stream_reader(chunk.data) as reader:
            data: bytes = reader.read(size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"a chunk is compressed by {chunk.compression!r}, which is not read here")
    if len(data) != size:
        raise ValueError(f"a chunk does not inflate to the {size:,} bytes that it declares")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("a chunk does not match its checksum")
    return data


def salvaged(source: memoryview, most: int) -> bytearray:
    """What a Zstandard frame holds, up to `most` bytes; of a damaged one what comes before, and
    perhaps zeros.
    """
    out = bytearray()
    window = max(_LARGEST_WINDOW, most)
    with zstandard.ZstdDecompressor(max_window_size=window).stream_reader(source) as reader:
        while len(out) < most:
            piece = bytearray(min(_PIECE, most - len(out)))
            try:
                count = reader.readinto(piece)
            except zstandard.ZstdError:
                # What was decompressed before the error has been written nevertheless.
                out += piece
                break
            if not count:
                break
            out += memoryview(piece)[:count]
    return out
