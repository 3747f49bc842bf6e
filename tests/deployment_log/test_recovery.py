"""Whatever happens to a log, what is read from it is right: all steps before the damage."""

import errno
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from otc_dist.deployment_log.format import DamagedLogError
from otc_dist.deployment_log.reader import read_header, read_steps
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.terminal.errors import UserError


def read_until_damage(path: Path) -> tuple[list, bool]:
    """The steps before the damage, and whether there was any."""
    steps = []
    try:
        for step in read_steps(path):
            steps.append(step)
    except UserError:
        return steps, True
    return steps, False


def partial_of(path: Path) -> Path:
    return path.with_name(path.name + ".partial")


STRIDE = 5  # no divisor of a step's length: every byte of a step is reached in one of five steps


def places(start: int, stop: int, exhaustive: bool) -> Iterator[int]:
    """Bytes' offsets, STRIDE apart, or a share of them that reaches every field in time."""
    return iter(range(start, stop, STRIDE if exhaustive else 37))


EXTENT = pytest.mark.parametrize(
    "exhaustive",
    [False, pytest.param(True, marks=pytest.mark.slow)],
    ids=["sample", "every byte of a step"],
)


@EXTENT
def test_an_unfinished_log_cut_anywhere(tmp_path: Path, small, same, exhaustive: bool) -> None:
    """Every complete step is left, and reading ends without complaint."""
    small.write(tmp_path / "log.mcap").close()
    data = partial_of(tmp_path / "log.mcap").read_bytes()
    sizes = [len(data)]  # where each step ends
    for kept in reversed(range(12)):
        small.write(tmp_path / f"{kept}.mcap", kept).close()
        sizes.append(partial_of(tmp_path / f"{kept}.mcap").stat().st_size)
    sizes.reverse()
    assert all((stop - start) % STRIDE for start, stop in pairwise(sizes))

    cut = tmp_path / "cut.mcap"
    for length in chain(
        places(0, sizes[0], exhaustive),
        range(sizes[0], sizes[1] + 20),
        places(sizes[2], len(data), exhaustive),
    ):
        cut.write_bytes(data[:length])
        steps, damaged = read_until_damage(cut)
        complete = sum(size <= length for size in sizes) - 1
        assert len(steps) == max(complete, 0)
        assert all(same(a, b) for a, b in zip(steps, small.steps, strict=False))
        assert damaged == (complete < 0)  # even the header is not whole


@EXTENT
def test_a_finished_log_cut_anywhere_is_never_read_wrong(
    tmp_path: Path, small, same, exhaustive: bool
) -> None:
    data = small.finish(tmp_path / "log.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    for length in places(0, len(data), exhaustive):
        cut.write_bytes(data[:length])
        steps, damaged = read_until_damage(cut)
        assert damaged and all(same(a, b) for a, b in zip(steps, small.steps, strict=False))


@EXTENT
@pytest.mark.parametrize("finished", [False, True])
def test_a_flipped_bit_never_makes_a_wrong_step(
    tmp_path: Path, small, same, finished: bool, exhaustive: bool
) -> None:
    path = tmp_path / "log.mcap"
    writer = small.write(path)
    if finished:
        writer.finish({})
        header = read_header(path)
    else:
        writer.close()
        path = partial_of(path)
        header = read_header(path)
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(1)
    unnoticed = 0
    flipped = tmp_path / "flipped.mcap"
    for at in places(0, len(data), exhaustive):
        bit = 1 << int(rng.integers(8))
        data[at] ^= bit
        flipped.write_bytes(data)
        data[at] ^= bit
        steps, damaged = read_until_damage(flipped)
        assert all(same(a, b) for a, b in zip(steps, small.steps, strict=False))
        if not damaged:
            unnoticed += 1
            assert len(steps) == len(small.steps)
            assert read_header(flipped) == header
    # Only what no step depends on, such as one of the two copies of the header, goes unnoticed.
    assert 0 < unnoticed < len(data)


def test_what_lies_before_flipped_bytes_is_read(tmp_path: Path, small, same) -> None:
    small.write(tmp_path / "log.mcap").close()
    partial = partial_of(tmp_path / "log.mcap")
    data = bytearray(partial.read_bytes())
    data[-1] ^= 1  # the last step's checksum
    partial.write_bytes(data)
    steps, damaged = read_until_damage(partial)
    assert damaged and len(steps) == 11
    assert all(same(a, b) for a, b in zip(steps, small.steps, strict=False))


_WRITE_FOR_EVER = """
import pickle, sys
from pathlib import Path
from dataclasses import replace
from otc_dist.deployment_log.writer import LogWriter
path, source = Path(sys.argv[1]), Path(sys.argv[2])
header, steps = pickle.loads(source.read_bytes())
writer = LogWriter.create(path, header)
t = 0
while True:
    writer.write(replace(steps[t % len(steps)], step=t))
    t += 1
    if t == 1000:
        print("recording", flush=True)
"""


def test_kill_9_loses_nothing_but_the_step_being_written(tmp_path: Path, small, same) -> None:
    import pickle
    from dataclasses import replace

    source, path = tmp_path / "source", tmp_path / "log.mcap"
    source.write_bytes(pickle.dumps((small.header, small.steps)))
    process = subprocess.Popen(
        [sys.executable, "-c", _WRITE_FOR_EVER, str(path), str(source)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    with process.stdout:
        assert process.stdout.readline() == "recording\n"
        process.send_signal(signal.SIGKILL)
        process.wait()

    writer, steps = LogWriter.resume(path)
    assert steps >= 1000
    writer.write(replace(small.steps[0], step=steps))
    writer.finish({})
    read = list(read_steps(path))
    assert len(read) == steps + 1
    for t, step in enumerate(read[:-1]):
        assert same(step, replace(small.steps[t % 12], step=t))
    assert same(read[-1], replace(small.steps[0], step=steps))


@pytest.mark.parametrize("tail", [b"", b"\x05", b"torn", bytes(5000)])
def test_resume_then_finish_equals_the_uninterrupted_log(
    tmp_path: Path, small, tail: bytes
) -> None:
    def contents(path: Path) -> list[tuple[int, bytes]]:
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            return [(m.sequence, m.data) for _, _, m in reader.iter_messages("joint_step")]

    whole = small.finish(tmp_path / "whole.mcap")
    broken = tmp_path / "broken.mcap"
    small.write(broken, 7).close()
    with partial_of(broken).open("ab") as stream:
        stream.write(tail)
    writer, steps = LogWriter.resume(broken)
    assert steps == writer.steps == 7
    for step in small.steps[7:]:
        writer.write(step)
    writer.finish({name: f"digest of {name}" for name in small.team.names})
    assert contents(broken) == contents(whole)


def test_resume_takes_the_steps_from_a_damaged_one_on_again(tmp_path: Path, small, same) -> None:
    path = tmp_path / "log.mcap"
    small.write(path).close()
    data = bytearray(partial_of(path).read_bytes())
    record = (len(data) - len(_empty(tmp_path, small))) // 12
    data[-3 * record + 100] ^= 0x10  # in step 9
    partial_of(path).write_bytes(data)
    writer, steps = LogWriter.resume(path)
    assert steps == 9
    for step in small.steps[9:]:
        writer.write(step)
    writer.finish({})
    assert all(same(a, b) for a, b in zip(read_steps(path), small.steps, strict=True))


def _empty(folder: Path, made) -> bytes:
    made.write(folder / "empty.mcap", 0).close()
    return partial_of(folder / "empty.mcap").read_bytes()


def test_a_full_disk_leaves_what_was_recorded(tmp_path: Path, small, same) -> None:
    """The file may not grow beyond the middle of step 5: the system writes a part, then fails."""
    path = tmp_path / "log.mcap"
    writer = small.write(path, 5)
    size = partial_of(path).stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 50, hard))
    try:
        with pytest.raises(OSError) as caught:
            writer.write(small.steps[5])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert caught.value.errno == errno.EFBIG
    assert partial_of(path).stat().st_size == size
    assert sum(1 for _ in read_steps(path)) == 5

    for step in small.steps[5:]:  # there is room again
        writer.write(step)
    writer.close()
    assert all(same(a, b) for a, b in zip(read_steps(path), small.steps, strict=True))


def test_a_disk_that_is_full_when_finishing_leaves_the_unfinished_log(
    tmp_path: Path, small, same
) -> None:
    path = tmp_path / "log.mcap"
    writer = small.write(path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        with pytest.raises(OSError):
            writer.finish({})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap.partial"]
    writer, steps = LogWriter.resume(path)
    assert steps == 12
    writer.finish({})
    assert all(same(a, b) for a, b in zip(read_steps(path), small.steps, strict=True))


def test_a_log_may_be_read_while_it_grows(tmp_path: Path, small, same) -> None:
    writer = LogWriter.create(tmp_path / "log.mcap", small.header)
    for t, step in enumerate(small.steps):
        writer.write(step)
        read = list(read_steps(writer.path, start=t))
        assert len(read) == 1 and same(read[0], step)
    writer.close()


def test_a_missing_chunk_is_noticed(tmp_path: Path, recording) -> None:
    """An index that leaves out a chunk, however well-formed, cannot hide its steps."""
    made = recording(((400, 9),) * 4, 4, 60, 3)
    path = made.finish(tmp_path / "log.mcap")
    data = path.read_bytes()
    from mcap.reader import make_reader as open_reader

    with path.open("rb") as stream:
        summary = open_reader(stream).get_summary()
    assert summary is not None and len(summary.chunk_indexes) > 2
    middle = summary.chunk_indexes[1]
    start, stop = middle.chunk_start_offset, middle.chunk_start_offset + middle.chunk_length
    path.write_bytes(data[:start] + bytes(stop - start) + data[stop:])
    steps, damaged = read_until_damage(path)
    assert damaged and 0 < len(steps) < 60
    with pytest.raises(DamagedLogError):
        list(read_steps(path))
