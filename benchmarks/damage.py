"""Is a damaged log ever read wrong, and how much of it is found?

    python benchmarks/damage.py [--steps 2000] [--flips 10000]

A log of 12 steps is cut at every byte, and in a large one bits are flipped, one at a time, at
random places; both are unfinished logs and finished ones. After each damage every step that is
read (until the reader complains) or recovered is compared with the one that was written. What must
hold: none is another; a cut costs no step before it, but for those of the compressed block that it
cuts; a flipped bit costs one step of an unfinished log, and of a finished one those of its chunk.
"""

import argparse
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from logs import record
from mcap.reader import make_reader
from numpy.typing import NDArray

from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.record import PAYLOAD_START, Rows
from otc_dist.deployment_log.salvage import Salvage
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.terminal.errors import UserError, run_main
from otc_dist.terminal.progress import shown

SMALL = 12  # steps


class Written:
    """A log as it was written, finished and not."""

    def __init__(self, folder: Path, steps: int) -> None:
        finished = record(folder / f"{steps}.mcap", steps)
        copy = LogWriter.create(folder / f"copy_{steps}.mcap", OpenLog(finished).header)
        with OpenLog(finished) as log:
            for rows in log.blocks():
                for step in log.layout.steps(rows):
                    copy.write(step)
            self.payloads = np.concatenate([_payloads(rows) for rows in log.blocks()])
            self.record = log.layout.size
        copy.close()
        self.finished = finished.read_bytes()
        self.unfinished = fmt.partial_path(copy.path).read_bytes()
        self.first = len(self.unfinished) - steps * self.record
        with finished.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary is not None
        self.chunks = [
            (index.chunk_start_offset, index.chunk_start_offset + index.chunk_length)
            for index in summary.chunk_indexes
        ]

    def numbers(self, blocks: Iterable[Rows]) -> set[int]:
        """Which steps there are until it ends or a reader complains; SystemExit for a wrong one."""
        found: set[int] = set()
        try:
            for rows in blocks:
                numbers = rows["step"].astype(np.int64)
                if not np.array_equal(_payloads(rows), self.payloads[numbers]):
                    raise SystemExit("WRONG: a step was read that was never written")
                found.update(numbers.tolist())
        except UserError:
            pass
        return found


def _payloads(rows: Rows) -> NDArray[np.uint8]:
    """All bytes (steps, bytes), also those between the fields, which NumPy need not copy."""
    return np.frombuffer(rows.tobytes(), np.uint8).reshape(len(rows), -1)[:, PAYLOAD_START:]


def _read(path: Path) -> Iterator[Rows]:
    with OpenLog(path) as log:
        yield from log.blocks()


def _salvaged(path: Path) -> Iterator[Rows]:
    with Salvage(path) as found:
        yield from found.blocks()


def cut(log: Written, path: Path) -> str:
    """Cut both logs at every byte."""
    for data, finished in ((log.unfinished, False), (log.finished, True)):
        before = 0
        with shown("cutting", "places") as report:
            for length in range(1, len(data)):
                path.write_bytes(data[:length])
                log.numbers(_read(path))
                found = len(log.numbers(_salvaged(path)))
                whole = max(0, (length - log.first) // log.record)
                if found != whole if not finished else found < before:
                    raise SystemExit(f"WRONG: cut at {length}, {found} steps are found")
                before = found
                report(length, len(data) - 1)
    return f"cut at {len(log.unfinished) + len(log.finished) - 2:,} bytes"


def flip(log: Written, path: Path, finished: bool, flips: int) -> str:
    """Flip bits of one log."""
    data = bytearray(log.finished if finished else log.unfinished)
    random, steps, lost_in_all, most = np.random.default_rng(int(finished)), len(log.payloads), 0, 0
    with shown("flipping", "bits") as report:
        for number in range(flips):
            at, bit = int(random.integers(len(data))), 1 << int(random.integers(8))
            data[at] ^= bit
            path.write_bytes(data)
            data[at] ^= bit
            log.numbers(_read(path))
            lost = steps - len(log.numbers(_salvaged(path)))
            in_chunk = any(low <= at < high for low, high in log.chunks)
            if lost > (0 if at < log.first else 1) if not finished else lost and not in_chunk:
                raise SystemExit(f"WRONG: a bit at {at} costs {lost} steps")
            lost_in_all, most = lost_in_all + lost, max(most, lost)
            report(number + 1, flips)
    kind = "a finished" if finished else "an unfinished"
    mean = lost_in_all / flips
    return f"{flips:,} bits of {kind} log flipped: {mean:.1f} steps lost each, {most} at most"


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--steps", type=int, default=2000, help="of the large log (%(default)s)")
    parser.add_argument("--flips", type=int, default=10_000, help="in all (%(default)s)")
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="damage") as name:
        folder = Path(name)
        path = folder / "damaged"
        print(f"{cut(Written(folder, SMALL), path)}: no step wrong, none lost before the cut")
        large, half = Written(folder, arguments.steps), arguments.flips // 2
        print(f"{arguments.steps:,} steps, {len(large.chunks)} chunks:")
        for finished in (False, True):
            print(f"  {flip(large, path, finished, half)}, none wrong", flush=True)
    return 0


if __name__ == "__main__":
    run_main(main)
