"""A step belongs to one run, deployment and description; in another log it is no step."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from otc_dist.deployment_log.format import DamagedLogError, partial_path
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import read_header, read_steps, read_summary
from otc_dist.deployment_log.salvage import Salvage
from otc_dist.deployment_log.seeds import SeedCheck
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.randomness import derive_seed
from otc_dist.transitions import JointStep

from .conftest import Recording, again

OTHERS = {
    "run": "another-run",
    "deployment": 4,
    "seed": 8,
    "description": 'name = "other"\n',
    "description_digest": "fedcba9876543210",
}


def unfinished(made: Recording, path: Path, header: LogHeader) -> bytes:
    writer = LogWriter.create(path, header)
    for step in made.steps:
        writer.write(step)
    writer.close()
    return partial_path(path).read_bytes()


def first_step(data: bytes, made: Recording) -> int:
    """Where the steps begin in an unfinished log, all of whose records are as long."""
    body = made.steps[1].state.tobytes()
    size = data.index(made.steps[2].state.tobytes()) - data.index(body)
    return len(data) - len(made.steps) * size


def salvaged(path: Path) -> Iterator[JointStep]:
    with Salvage(path) as found:
        for rows in found.blocks():
            yield from found.layout.steps(rows)


@pytest.mark.parametrize("field", OTHERS)
def test_steps_of_another_log_are_none_of_this_one(
    tmp_path: Path, small: Recording, same, field: str
) -> None:
    """As when blocks of a deleted file are where a power cut left those of this one unwritten."""
    other = Recording(((3, 1), (2, 2)), copies=2, steps=12)
    other.steps = [replace(step, state=step.state + 1) for step in other.steps]
    theirs = unfinished(
        other, tmp_path / "other.mcap", replace(small.header, **{field: OTHERS[field]})
    )
    data = unfinished(small, tmp_path / "log.mcap", small.header)
    mine, foreign = data[first_step(data, small) :], theirs[first_step(theirs, other) :]
    size = len(mine) // 12
    spliced = tmp_path / "spliced.mcap"
    head = data[: first_step(data, small)]
    spliced.write_bytes(head + mine[: 3 * size] + foreign[3 * size : 8 * size] + mine[8 * size :])

    read = []
    with pytest.raises(DamagedLogError):
        for step in read_steps(spliced):
            read.append(step)
    assert [step.step for step in read] == [0, 1, 2]
    found = list(salvaged(spliced))
    assert [step.step for step in found] == [0, 1, 2, 8, 9, 10, 11]
    assert all(same(step, small.steps[step.step]) for step in found)


def test_tables_of_another_log_are_none_of_this_one(tmp_path: Path, small: Recording) -> None:
    path = small.finish(tmp_path / "log.mcap")
    data = path.read_bytes()
    small.header = replace(small.header, run="b-run")
    other = small.finish(tmp_path / "other.mcap").read_bytes()
    at, there = data.index(b"otc_dist.policies"), other.index(b"otc_dist.policies")
    stop = data.index(b"otc_dist.episodes")
    path.write_bytes(data[:at] + other[there : there + stop - at] + data[stop:])
    with pytest.raises(DamagedLogError, match=r"otc_dist\.policies"):
        read_summary(path)
    with Salvage(path) as found:
        assert found.policies() == {}


@pytest.mark.parametrize("finished", [False, True])
def test_the_older_form_is_read_as_before(
    tmp_path: Path, small: Recording, same, finished: bool
) -> None:
    small.header = replace(small.header, format_version=1)
    path = tmp_path / "log.mcap"
    writer = small.write(path)
    writer.finish({"agent_0": "a"}) if finished else writer.close()
    assert read_header(path) == small.header and not small.header.bound
    assert all(map(same, read_steps(path), small.steps))
    assert all(map(same, salvaged(path if finished else partial_path(path)), small.steps))
    assert read_summary(path).policies == ({"agent_0": "a"} if finished else {})


def test_an_older_log_is_gone_on_with_in_its_form(tmp_path: Path, small: Recording, same) -> None:
    path = tmp_path / "log.mcap"
    small.write(path, 7).close()
    again(partial_path(path), format_version=1)
    writer, steps = LogWriter.resume(path)
    assert steps == 7
    for step in small.steps[7:]:
        writer.write(step)
    writer.finish({})
    assert read_header(path).format_version == 1
    assert all(map(same, read_steps(path), small.steps))


@pytest.mark.parametrize(("mine", "theirs"), [(1, 2), (2, 1)])
def test_a_header_of_the_other_form_makes_no_step_good(
    tmp_path: Path, small: Recording, mine: int, theirs: int
) -> None:
    data = unfinished(small, tmp_path / "a.mcap", replace(small.header, format_version=mine))
    other = unfinished(small, tmp_path / "b.mcap", replace(small.header, format_version=theirs))
    path = tmp_path / "forged.mcap"
    path.write_bytes(other[: first_step(other, small)] + data[first_step(data, small) :])
    read = []
    with suppress(DamagedLogError):
        for step in read_steps(path):
            read.append(step)
    assert read == [] and list(salvaged(path)) == []


def seeded(made: Recording) -> None:
    """Give the recording's steps the seeds that its header's seed gives."""
    numbers = [0] * made.header.copies
    for t, step in enumerate(made.steps):
        seeds = [
            derive_seed(made.header.seed, "deployment", made.header.deployment, copy, number)
            for copy, number in enumerate(numbers)
        ]
        made.steps[t] = replace(step, episode_seeds=np.array(seeds))
        for copy in np.flatnonzero(step.terminated | step.truncated):
            numbers[copy] += 1


def wrong_seeds(path: Path, *without: int) -> list[tuple[int, int]]:
    """(step, copy) of what a check finds in the steps but `without`."""
    found = []
    with OpenLog(path) as log:
        check = SeedCheck(log.header)
        for rows in log.blocks():
            kept = rows[~np.isin(rows["step"], without)]
            wrong = check.wrong(kept)
            found += [(int(kept["step"][t]), int(copy)) for t, copy in np.argwhere(wrong)]
    return found


@pytest.mark.parametrize("without", [(), (0,), tuple(range(20)), (5, 6, 17, 18, 19, 31)])
def test_seeds_are_checked_at_every_step_also_behind_gaps(
    tmp_path: Path, without: tuple[int, ...]
) -> None:
    made = Recording(((2, 1),) * 2, copies=2, steps=40)
    seeded(made)
    path = made.finish(tmp_path / "log.mcap")
    assert wrong_seeds(path, *without) == []
    ends = [t for t, step in enumerate(made.steps) if (step.terminated | step.truncated)[1]]
    start = next(t for t in ends if t >= 20) + 1
    stop = next((t for t in ends if t >= start), 39) + 1
    for t in range(start, stop):  # an episode of copy 1 has a seed of copy 0
        seeds = made.steps[t].episode_seeds
        made.steps[t] = replace(made.steps[t], episode_seeds=np.array([seeds[0], seeds[0]]))
    other = made.finish(tmp_path / "other.mcap")
    expected = [(t, 1) for t in range(start, stop) if t not in without]
    assert wrong_seeds(other, *without) == expected
