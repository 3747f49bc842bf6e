"""After a power cut at any moment a log holds every step that it had promised to keep."""

import os
import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from otc_dist.deployment_log import writer as module
from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.reader import read_steps
from otc_dist.deployment_log.writer import LogWriter
from tests.power_cut import Disk, State

from .conftest import Recording, same_step


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where the logs are."""
    made = tmp_path / "run"
    made.mkdir()
    return made


@pytest.fixture
def disk(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    with closing(Disk(folder, monkeypatch)) as made:
        yield made
        monkeypatch.undo()


@pytest.fixture
def survivors(small: Recording, tmp_path: Path) -> "Survivors":
    return Survivors(small, tmp_path / "after")


class Survivors:
    """How many steps of a log are left in a state of the disk; none of them is another."""

    def __init__(self, made: Recording, scratch: Path) -> None:
        self._made, self._scratch = made, scratch
        self._known: dict[tuple[tuple[str, bytes], ...], int] = {}
        self.fewest = len(made.steps)

    def count(self, state: State) -> int:
        key = tuple(sorted(state.items()))
        if key not in self._known:
            self._known[key] = self._counted(state)
        return self._known[key]

    def look(self, state: State) -> None:
        self.fewest = min(self.fewest, self.count(state))

    def _counted(self, state: State) -> int:
        shutil.rmtree(self._scratch, ignore_errors=True)
        for name, data in state.items():
            path = self._scratch / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        path = self._scratch / "deployments" / "log.mcap"
        if path.exists():  # the run takes it as it is
            steps = list(read_steps(path))
            assert len(steps) == len(self._made.steps)
        elif partial_path(path).exists():  # and with this it goes on
            writer, count = LogWriter.resume(path)
            writer.close()
            steps = list(read_steps(path))
            assert len(steps) == count
        else:
            return -1
        assert all(map(same_step, steps, self._made.steps))
        return len(steps)


def begun(small: Recording, folder: Path) -> LogWriter:
    return LogWriter.create(folder / "deployments" / "log.mcap", small.header)


def test_a_log_that_was_begun_is_there(
    small: Recording, folder: Path, disk: Disk, survivors: Survivors
) -> None:
    """Under its name, in a folder that was made for it, with a whole header."""
    disk.watch(survivors.look)  # nothing is ever half there
    with closing(begun(small, folder)):
        disk.watch(None)
        assert {survivors.count(state) for state in disk.states()} == {0}


def test_steps_that_were_forced_to_the_disk_stay(
    small: Recording, folder: Path, disk: Disk, survivors: Survivors,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """On a disk that takes 2 ms: it may take a twentieth of the time, so 38 ms pass in between.

    A lock-step takes 15 ms here, so the steps since are two and the one that is written.
    """
    now, force = [0.0], os.fdatasync

    def forced(handle: int) -> None:
        force(handle)
        now[0] += 0.002

    monkeypatch.setattr(os, "fdatasync", forced)
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    with closing(begun(small, folder)) as writer:
        lost = []
        for step in small.steps:
            writer.write(step)
            lost.append(step.step + 1 - min(map(survivors.count, disk.states())))
            now[0] += 0.015
    assert lost == [0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2]


def test_a_disk_that_is_fast_keeps_every_step_and_a_slow_one_those_before_a_second(
    small: Recording, folder: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, cost, force = [0.0], [0.00005], os.fdatasync

    def forced(handle: int) -> None:
        force(handle)
        now[0] += cost[0]

    monkeypatch.setattr(os, "fdatasync", forced)
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    with closing(begun(small, folder)) as writer:
        before, synced = disk.syncs, []
        for step in small.steps:
            cost[0] = 0.00005 if step.step < 6 else 0.5
            writer.write(step)
            synced.append(disk.syncs > before)
            before = disk.syncs
            now[0] += 0.001 if step.step < 6 else 0.3
    assert synced == [True] * 7 + [False, False, False, True, False]


def test_a_log_that_was_closed_keeps_all_its_steps(
    small: Recording, folder: Path, disk: Disk, survivors: Survivors,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(module, "_SYNCING", 1e-9)  # hardly ever before
    writer = begun(small, folder)
    for step in small.steps:
        writer.write(step)
    assert min(map(survivors.count, disk.states())) == 1
    writer.close()
    assert {survivors.count(state) for state in disk.states()} == {12}


def test_finishing_a_log_loses_no_step_at_any_moment(
    small: Recording, folder: Path, disk: Disk, survivors: Survivors
) -> None:
    """The unfinished log goes once the finished one is there under its name, and not before."""
    writer = begun(small, folder)
    for step in small.steps:
        writer.write(step)
    writer.close()
    disk.watch(survivors.look)
    writer.finish({})
    disk.watch(None)
    assert survivors.fewest == 12
    assert all("deployments/log.mcap" in state for state in disk.states())
