"""How fast are deployment logs: to look at, to read, to record?

    python benchmarks/logs.py [--steps 10000] [--rounds 9]

A deployment of 3-agent Hopper with random actions, E = 1. *Summary* is `python -m otc_dist.replay`
after its imports. *Reading* takes turns with the mcap library's own reader, which gives the same
messages as bytes; ours checks every step's checksum and gives arrays. *Recording* is the share of
writing in a lock-step with three processes that answer (see lockstep.py), added to the rest.
"""

import argparse
import contextlib
import io
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from lockstep import ours
from mcap.reader import make_reader

from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.reader import read_steps
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout
from otc_dist.replay.__main__ import main as replay
from otc_dist.terminal.errors import run_main
from otc_dist.transitions import JointStep

SUMMARY, READING, RECORDING = 0.3, 0.8, 0.1  # at most seconds, at least and at most shares


def record(path: Path, steps: int) -> Path:
    """A finished log."""
    env = registry.make("hopper-3x1", 1)
    rollout, random = Rollout(env, 0, "deployment", 1), np.random.default_rng(0)
    writer = LogWriter.create(path, LogHeader("benchmark", 1, 0, "", "", env.spec, 1))
    for _ in range(steps):
        actions = [random.uniform(-1, 1, (1, 1)).astype(np.float32) for _ in env.spec.agents]
        writer.write(rollout.advance(actions, (False,) * 3))
    return writer.finish(dict.fromkeys(env.spec.names, "0" * 16))


def seconds(what: Callable[[], object]) -> float:
    """The processor's."""
    start = time.process_time()
    what()
    return time.process_time() - start


def summary(path: Path) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        replay([str(path)])


def read_by_mcap(path: Path) -> int:
    with path.open("rb") as stream:
        messages = make_reader(stream).iter_messages(fmt.TOPIC)
        return sum(len(message.data) for _, _, message in messages)


def read_by_us(path: Path) -> int:
    return sum(len(step.actions) for step in read_steps(path))


def recording(folder: Path, steps: int) -> float:
    """What writing adds to the rest of a lock-step, as a share of it."""
    spent, write = 0.0, LogWriter.write

    def timed(self: LogWriter, step: JointStep) -> None:
        nonlocal spent
        start = time.perf_counter()
        write(self, step)
        spent += time.perf_counter() - start

    LogWriter.write = timed  # type: ignore[method-assign]
    with ours(folder) as step:
        for number in range(200):
            step(number)
        spent, start = 0.0, time.perf_counter()
        for number in range(200, 200 + steps):
            step(number)
        whole = time.perf_counter() - start
    LogWriter.write = write  # type: ignore[method-assign]
    return spent / (whole - spent)


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--steps", type=int, default=10_000, help="of the log (%(default)s)")
    parser.add_argument("--rounds", type=int, default=9, help="turns of each (%(default)s)")
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="logs") as name:
        path = record(Path(name) / "log.mcap", arguments.steps)
        size = path.stat().st_size / 1e6
        print(f"{arguments.steps:,} steps, {size:.1f} MB, medians of {arguments.rounds} turns")
        rounds = range(arguments.rounds)
        looked = statistics.median(seconds(lambda: summary(path)) for _ in rounds)
        _tell("summary", f"{looked:.3f} s", looked <= SUMMARY, f"at most {SUMMARY} s")
        pairs = [(seconds(lambda: read_by_mcap(path)), seconds(lambda: read_by_us(path)))
                 for _ in rounds]  # fmt: skip
        share = statistics.median(theirs / mine for theirs, mine in pairs)
        theirs, mine = (arguments.steps / statistics.median(x) for x in zip(*pairs, strict=True))
        text = f"{mine:,.0f} steps/s, {share:.0%} of the mcap library's {theirs:,.0f}"
        _tell("reading", text, share >= READING, f"at least {READING:.0%}")
        added = recording(Path(name), 2000)
        _tell("recording", f"{added:.1%} of a lock-step", added <= RECORDING, f"{RECORDING:.0%}")
    return 0


def _tell(what: str, measured: str, met: bool, limit: str) -> None:
    print(f"{what:10} {measured} ({limit}: {'met' if met else 'MISSED'})", flush=True)


if __name__ == "__main__":
    run_main(main)
