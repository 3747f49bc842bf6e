"""How soon is a frozen process noticed?

    python benchmarks/frozen.py [--times 20]

A run (one env host, two learners) goes on while one process after another is stopped (SIGSTOP) at
a random time; prints the seconds until the launcher says that it is silent, in which it then goes
on. At most 2 s are allowed.
"""

import argparse
import os
import random
import signal
import statistics
import sys
import tempfile
import time
from pathlib import Path

from otc_dist.launch.chaos.command import SHORT_RUN
from otc_dist.launch.chaos.disturbed_run import LOOK, DisturbedRun

LIMIT = 2.0
LONG = ("--set", "deployment.count=1000")


def noticed(run: DisturbedRun, name: str) -> float:
    """Freeze a process that is up; the seconds until it is known not to be."""
    pid = run.processes[name].pid
    start = time.perf_counter()
    os.kill(pid, signal.SIGSTOP)
    try:
        while run.processes[name].health == "up":
            time.sleep(LOOK)
        return time.perf_counter() - start
    finally:
        os.kill(pid, signal.SIGCONT)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--times", type=int, default=20, help="of each process (default: 20)")
    times: int = parser.parse_args().times
    numbers = random.Random(0)
    found: dict[str, list[float]] = {"host": [], "agent_0": [], "agent_1": []}
    with (
        tempfile.TemporaryDirectory(prefix="otc-frozen-") as folder,
        DisturbedRun(Path(folder) / "run", (*SHORT_RUN, *LONG)) as run,
    ):
        run.start()
        for turn in range(times):
            for name, seconds in found.items():
                run.settle()
                run.wait(numbers.uniform(0.0, 1.0))
                seconds.append(noticed(run, name))
            print(f"{turn + 1} of {times}", file=sys.stderr)
    print("process    median s   longest s")
    for name, seconds in found.items():
        print(f"{name:8} {statistics.median(seconds):10.2f} {max(seconds):11.2f}")
    longest = max(max(seconds) for seconds in found.values())
    print(f"longest {longest:.2f} s: {'met' if longest <= LIMIT else 'MISSED'} ({LIMIT:g} s)")
    return int(longest > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
