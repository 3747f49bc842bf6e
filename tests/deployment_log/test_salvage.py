"""Every whole step of a damaged log is found, and none that is not the one that was written."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from otc_dist.deployment_log.finishing import write_finished
from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.reader import read_header, read_steps, read_summary
from otc_dist.deployment_log.record import CHANNEL_ID
from otc_dist.deployment_log.salvage import Salvage
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import JointStep

# benchmarks/damage.py cuts at every byte and flips 10,000 bits.
STRIDE, FLIPS = 41, 40


def salvaged(path: Path) -> dict[int, JointStep]:
    """The whole steps of a log, by number; none if its header is not whole."""
    try:
        with Salvage(path) as found:
            return {step.step: step for rows in found.blocks() for step in found.layout.steps(rows)}
    except UserError:
        return {}


def contents(path: Path) -> list[tuple[int, bytes]]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [(m.sequence, m.data) for _, _, m in reader.iter_messages("joint_step")]


def test_an_unfinished_log_cut_anywhere(tmp_path: Path, small, same) -> None:
    small.write(tmp_path / "log.mcap").close()
    data = partial_path(tmp_path / "log.mcap").read_bytes()
    record = (len(data) - len(_unfinished(tmp_path, small, 0))) // 12
    start, cut = len(data) - 12 * record, tmp_path / "cut"
    for length in range(1, len(data), STRIDE):
        cut.write_bytes(data[:length])
        steps = salvaged(cut)
        if length >= start:
            assert len(steps) == (length - start) // record
        assert all(same(step, small.steps[number]) for number, step in steps.items())


def _unfinished(folder: Path, made, stop: int) -> bytes:
    made.write(folder / f"{stop}.mcap", stop).close()
    return partial_path(folder / f"{stop}.mcap").read_bytes()


def test_a_finished_log_cut_anywhere(tmp_path: Path, small, same) -> None:
    """Its 12 steps are one block of Zstandard: all of them or none."""
    data = small.finish(tmp_path / "log.mcap").read_bytes()
    cut, before = tmp_path / "cut", 0
    for length in [*range(1, len(data), STRIDE), len(data)]:
        cut.write_bytes(data[:length])
        steps = salvaged(cut)
        assert len(steps) >= before
        before = len(steps)
        assert all(same(step, small.steps[number]) for number, step in steps.items())
    assert before == 12


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory, recording_of) -> tuple[object, bytes, bytes]:
    """600 steps: the recording, the unfinished log and the finished one, of several chunks."""
    folder = tmp_path_factory.mktemp("large")
    made = recording_of(((50, 3), (40, 2)), 2, 600, 5)
    writer = made.write(folder / "log.mcap")
    writer.close()
    unfinished = partial_path(folder / "log.mcap").read_bytes()
    finished = made.finish(folder / "finished.mcap").read_bytes()
    return made, unfinished, finished


def flips(size: int, seed: int) -> Iterator[tuple[int, int]]:
    """Places and bits."""
    rng = np.random.default_rng(seed)
    yield from zip(rng.integers(size, size=FLIPS), 1 << rng.integers(8, size=FLIPS), strict=True)


def test_a_flipped_bit_in_an_unfinished_log_costs_one_step(tmp_path: Path, large, same) -> None:
    made, unfinished, _ = large
    data, path = bytearray(unfinished), tmp_path / "flipped"
    for at, bit in flips(len(data), 1):
        data[at] ^= bit
        path.write_bytes(data)
        data[at] ^= bit
        steps = salvaged(path)
        assert len(steps) >= 599
        assert all(same(step, made.steps[number]) for number, step in steps.items())


def test_a_flipped_bit_in_a_finished_log_costs_no_other_chunks_steps(
    tmp_path: Path, large, same
) -> None:
    made, _, finished = large
    path = tmp_path / "log"
    path.write_bytes(finished)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    chunks, steps_in = [], []
    assert summary is not None
    for index in summary.chunk_indexes:
        with path.open("rb") as stream:
            stream.seek(index.chunk_start_offset)
            chunk = next(StreamReader(stream, skip_magic=True, emit_chunks=True).records)
            assert isinstance(chunk, Chunk)
            numbers = {
                record.sequence
                for record in breakup_chunk(chunk)
                if isinstance(record, Message) and record.channel_id == CHANNEL_ID
            }
        chunks.append((index.chunk_start_offset, index.chunk_start_offset + index.chunk_length))
        steps_in.append(numbers)
    assert sum(bool(numbers) for numbers in steps_in) > 3

    data = bytearray(finished)
    for at, bit in flips(len(data), 2):
        data[at] ^= bit
        path.write_bytes(data)
        data[at] ^= bit
        steps = salvaged(path)
        hit = [n for (low, high), n in zip(chunks, steps_in, strict=True) if low <= at < high]
        lost = set(range(600)) - set(steps)
        assert lost <= set().union(*hit)
        assert all(same(step, made.steps[number]) for number, step in steps.items())


def test_the_steps_before_the_damage_in_a_chunk_are_found(tmp_path: Path, large) -> None:
    """A chunk is several blocks, each of which is decompressed by itself."""
    made, _, finished = large
    path = tmp_path / "log"
    path.write_bytes(finished)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    second = summary.chunk_indexes[1]
    at = second.chunk_start_offset + second.chunk_length - 1000  # in the last block of it
    data = bytearray(finished)
    data[at : at + 900] = bytes(900)
    path.write_bytes(data)
    lost = sorted(set(range(len(made.steps))) - set(salvaged(path)))
    chunk = len(made.steps) // len(summary.chunk_indexes)
    assert 0 < len(lost) < chunk
    assert lost == list(range(lost[0], lost[-1] + 1))


def with_gaps(folder: Path, made, unfinished: bytes, *steps: int) -> Path:
    """A finished log made of an unfinished one in which `steps` are damaged."""
    record = (len(unfinished) - len(_unfinished(folder, made, 0))) // len(made.steps)
    data = bytearray(unfinished)
    for step in steps:
        data[len(data) - (len(made.steps) - step) * record + record // 2] ^= 1
    damaged, path = folder / "damaged", folder / "gaps.mcap"
    damaged.write_bytes(data)
    with Salvage(damaged) as found:
        write_finished(path, found.header, found.blocks, found.policies())
    return path


def test_a_log_with_gaps_tells_them_and_is_read_by_step(tmp_path: Path, large, same) -> None:
    made, unfinished, _ = large
    path = with_gaps(tmp_path, made, unfinished, 0, 200, 201, 599)
    summary = read_summary(path)
    assert summary.extent.ranges == [(1, 200), (202, 599)]
    assert (summary.steps, summary.end) == (596, 599)
    assert read_header(path) == made.header
    for start, stop in ((0, None), (150, 250), (200, 202), (201, 203), (598, 700), (300, 310)):
        expected = [s for s in made.steps[start:stop] if s.step not in (0, 200, 201, 599)]
        read = list(read_steps(path, start, stop))
        assert len(read) == len(expected)
        assert all(same(a, b) for a, b in zip(read, expected, strict=True))


def test_an_episode_that_lost_its_beginning_says_so(tmp_path: Path, large) -> None:
    made, unfinished, finished = large
    whole = tmp_path / "whole.mcap"
    whole.write_bytes(finished)
    before = {(e.start, e.copy): e for e in read_summary(whole).episodes}
    after = read_summary(with_gaps(tmp_path, made, unfinished, 300)).episodes
    broken = [episode for episode in after if not episode.whole]
    assert {(e.start, e.copy) for e in broken} == {(301, 0), (301, 1)}
    for episode in after:
        if episode.whole and episode.start + episode.length != 300:
            assert episode == before[episode.start, episode.copy]
    assert sum(episode.length for episode in after) == 2 * 599


def test_salvaging_an_undamaged_log_changes_nothing(tmp_path: Path, large) -> None:
    _, _, finished = large
    path, again = tmp_path / "log.mcap", tmp_path / "again.mcap"
    path.write_bytes(finished)
    with Salvage(path) as found:
        write_finished(again, found.header, found.blocks, found.policies())
    assert contents(again) == contents(path)
    assert replace(read_summary(again), path=path) == read_summary(path)


def test_steps_that_are_there_twice_or_elsewhere_are_given_once_and_in_order(
    tmp_path: Path, small, same
) -> None:
    """Blocks of a file may be where other blocks of it belong, after a disk was repaired."""
    data = _unfinished(tmp_path, small, 12)
    start = len(_unfinished(tmp_path, small, 0))
    size = (len(data) - start) // 12
    steps = [data[start + t * size :][:size] for t in range(12)]
    path = tmp_path / "displaced"
    order = [0, 1, 8, 9, 10, 5, 5, 6, 2, 8, 11]  # 3, 4 and 7 were overwritten
    path.write_bytes(data[:start] + b"".join(steps[t] for t in order))
    with Salvage(path) as found:
        for _ in range(2):  # a finished log is made of them in two passes
            blocks = list(found.blocks())
            given = [step for rows in blocks for step in found.layout.steps(rows)]
            assert [step.step for step in given] == [0, 1, 2, 5, 6, 8, 9, 10, 11]
            assert all(same(step, small.steps[step.step]) for step in given)
    finished = small.finish(tmp_path / "finished.mcap").read_bytes()
    path.write_bytes(finished + data[start:])  # in a frame, and once more as they are
    with Salvage(path) as found:
        assert sum(len(rows) for rows in found.blocks()) == 12


def test_damaged_times_keep_their_order(tmp_path: Path, small) -> None:
    """They are no part of a step, so nothing else vouches for them."""
    small.write(tmp_path / "log.mcap").close()
    path = partial_path(tmp_path / "log.mcap")
    data = bytearray(path.read_bytes())
    record = (len(data) - len(_unfinished(tmp_path, small, 0))) // 12
    start = len(data) - 12 * record
    before = [int.from_bytes(data[start + t * record + 15 :][:8], "little") for t in range(12)]
    data[start + 3 * record + 22] ^= 0x40  # log time of step 3: far in the future
    data[start + 5 * record + 29] ^= 0x10  # publish time of step 5: back in the past
    path.write_bytes(data)
    with Salvage(path) as found:
        after = [int(time) for rows in found.blocks() for time in rows["log_time"]]
    assert after == before


def test_a_log_without_a_header_is_refused_in_one_line(tmp_path: Path, small) -> None:
    path = tmp_path / "log.mcap"
    whole = _unfinished(tmp_path, small, 1)
    short = "too short to hold the header of a deployment log"
    for content, said in (
        (b"", "is empty"),
        (bytes(5000), "no whole header"),
        *((whole[:size], short) for size in (1, 8, 10, 40, 60, 500)),
        (whole[:60].replace(b"x-otc", b"x-abc"), "not of profile"),
    ):
        path.write_bytes(content)
        with pytest.raises(UserError, match=said):
            Salvage(path)
    with pytest.raises(UserError, match="cannot be read"):
        Salvage(tmp_path / "none")
