"""Throws hostile and broken messages at every receiver of the bus.

    python -m tests.bus.fuzz [--count 1000000] [--seed 0]

Each receiver is the real one, behind a session that hands it what the fuzzer makes: wrong lengths,
types, runs, agents, versions, epochs, moments, NaN, infinities, huge numbers and arrays, msgpack
bombs, noise, and messages that were right a moment ago. None of them is what the receiver waits
for, so each must be rejected, with a reason; at the end comes the right message, which must be
taken. Prints, for each receiver, the payloads by reason, payloads a second, and how much memory
the process grew over the last nine tenths.
"""

import argparse
import os
import random
import sys
import time
from pathlib import Path
from types import SimpleNamespace

from otc_dist.bus import handshake, history
from otc_dist.bus.wire import Rejections
from tests.bus.receivers import RECEIVERS


def resident() -> int:
    """Bytes of memory that this process holds."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE")


def run(name: str, count: int, seed: int) -> tuple[dict[str, int], int]:
    """Payloads by reason, and the bytes by which memory grew over the last nine tenths."""
    rejections, noise = Rejections(), random.Random(seed)
    first = count // 10
    RECEIVERS[name](first, rejections, noise)
    before = resident()
    RECEIVERS[name](count - first, rejections, noise)
    grown = resident() - before
    counts = rejections.as_metrics()
    return {key.removeprefix("rejected/"): int(n) for key, n in counts.items()}, grown


def without_pauses() -> None:
    """Let receivers ask again at once after a message that they refused."""
    clock = SimpleNamespace(monotonic=time.monotonic, sleep=lambda seconds: None)
    for module in (handshake, history):
        module.time = clock  # type: ignore[attr-defined]


def main() -> int:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--count", type=int, default=1_000_000, help="payloads at each receiver")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    without_pauses()
    wrong = 0
    for name in RECEIVERS:
        start = time.monotonic()
        counts, grown = run(name, arguments.count, arguments.seed)
        rate = arguments.count / (time.monotonic() - start)
        total = sum(counts.values())
        wrong += total != arguments.count
        by_reason = ", ".join(f"{reason} {n:,}" for reason, n in counts.items())
        print(
            f"{name:21} {arguments.count:,} sent, {total:,} rejected, {rate:,.0f}/s,"
            f" memory {grown / 2**20:+.1f} MiB: {by_reason}",
            flush=True,
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
