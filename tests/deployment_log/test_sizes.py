"""A few bytes that stand for gigabytes: readers stop at what a chunk can hold, and say so."""

import tracemalloc
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import mcap.writer
import pytest
import zstandard
from mcap.records import Chunk

from otc_dist.deployment_log import chunks
from otc_dist.deployment_log.format import DamagedLogError
from otc_dist.deployment_log.reader import read_steps
from otc_dist.deployment_log.salvage import Salvage
from otc_dist.replay.__main__ import main
from otc_dist.terminal.errors import UserError
from tests.deployment_log.conftest import Recording

STEP = 1000  # bytes
BOMB = 2**28  # bytes of zeros
ENOUGH = 3 * (chunks.LARGEST + 2**20)  # bytes that a reader may need


def frame(size: int, **settings: object) -> bytes:
    """Zeros in a Zstandard frame, made piece by piece."""
    compressor = zstandard.ZstdCompressor(**settings).compressobj(size=size)
    pieces = [compressor.compress(bytes(2**20)) for _ in range(size // 2**20)]
    return b"".join((*pieces, compressor.flush()))


@pytest.fixture(scope="module")
def bomb() -> bytes:
    made = frame(BOMB)
    assert len(made) < 2**15
    return made


def chunk(data: bytes, declared: int, crc: int = 0, compression: str = "zstd") -> Chunk:
    return Chunk(
        compression=compression, data=data, message_start_time=0, message_end_time=0,
        uncompressed_crc=crc, uncompressed_size=declared,
    )  # fmt: skip


@contextmanager
def little_memory() -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < ENOUGH
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("declared", "said"),
    [
        (2**18, "does not inflate to the 262,144 bytes"),
        (0, "does not inflate to the 0 bytes"),
        (BOMB, "is to inflate to 268,435,456 bytes"),
        (2**63, "is to inflate to"),
    ],
)
def test_a_chunk_that_lies_or_is_too_large_is_not_inflated(
    bomb: bytes, declared: int, said: str
) -> None:
    with little_memory(), pytest.raises((ValueError, zstandard.ZstdError)) as caught:
        chunks.contents(chunk(bomb, declared), STEP)
    assert said in str(caught.value) or "memory" in str(caught.value)


def test_a_frame_that_asks_for_a_large_window_is_not_read() -> None:
    parameters = zstandard.ZstdCompressionParameters.from_level(3, window_log=27)
    compressor = zstandard.ZstdCompressor(compression_params=parameters).compressobj()
    data = compressor.compress(bytes(2**18)) + compressor.flush()
    with little_memory(), pytest.raises(zstandard.ZstdError):
        chunks.contents(chunk(data, 2**18), STEP)


def test_a_chunk_of_ours_is_read_whatever_its_compression() -> None:
    content = bytes(range(256)) * 1000
    crc = zlib.crc32(content)
    packed = zstandard.compress(content)
    assert chunks.contents(chunk(packed, len(content), crc), STEP) == content
    assert chunks.contents(chunk(content, len(content), crc, ""), STEP) == content
    with pytest.raises(ValueError, match="checksum"):
        chunks.contents(chunk(packed, len(content), crc ^ 1), STEP)
    with pytest.raises(ValueError, match="'lz4', which is not read here"):
        chunks.contents(chunk(packed, len(content), crc, "lz4"), STEP)


@pytest.fixture
def bombed(tmp_path: Path, small: Recording, bomb: bytes, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A finished log whose only chunk of steps holds a bomb instead."""
    packed = iter((bomb,))
    compress = lambda data: next(packed, None) or zstandard.compress(data)  # noqa: E731
    monkeypatch.setattr(mcap.writer, "zstandard", SimpleNamespace(compress=compress))
    return small.finish(tmp_path / "log.mcap")


def test_no_reader_of_a_log_inflates_a_bomb(bombed: Path, tmp_path: Path) -> None:
    assert bombed.stat().st_size < 2**16
    with little_memory(), pytest.raises(DamagedLogError, match=r"does not inflate|memory"):
        list(read_steps(bombed))
    with little_memory(), Salvage(bombed) as salvage:
        assert not list(salvage.blocks())
    with pytest.raises(UserError, match="is damaged"):
        main([str(bombed), "--export", "csv", "--out", str(tmp_path / "out")])
    assert main([str(bombed), "--verify"]) == 1
