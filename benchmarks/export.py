"""How long does it take to export a million transitions, and how much memory?

    python benchmarks/export.py [--transitions 1000000] [--only parquet,csv]

The log is written by the real writer, with 3-agent Hopper's sizes, four copies and random numbers;
episodes end at random, after 100 steps on average. Each export is the command in a process of its
own, which writes a data set for each agent and, where the format allows, the joint one. The memory
of a quarter of the transitions stands beside that of all: it does not grow with the log. An export
ends with its files forced to the disk; the processor's seconds say what remains on a faster one.
"""

import argparse
import os
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs import registry
from otc_dist.replay.export.formats import FORMATS
from otc_dist.terminal.errors import run_main
from otc_dist.terminal.progress import shown
from otc_dist.transitions import JointStep

ENV, COPIES = "hopper-3x1", 4
SECONDS = 60.0  # at most, for a million transitions
GROWTH = 1.25  # at most: memory for all by memory for a quarter


@dataclass(frozen=True)
class Cost:
    seconds: float
    processor: float  # seconds
    memory: float  # MB at its largest
    disk: float  # MB


def record(path: Path, transitions: int) -> Path:
    """A finished log of random steps."""
    team, random = registry.team_spec(ENV), np.random.default_rng(0)
    writer = LogWriter.create(path, LogHeader("benchmark", 1, 0, "", "", team, COPIES))
    seen = random.standard_normal((COPIES, 11), np.float32)
    seeds, never = np.arange(COPIES), np.zeros(COPIES, np.bool_)
    steps = transitions // COPIES
    with shown("recording", "steps") as report:
        for number in range(steps):
            successors = random.standard_normal((COPIES, 11), np.float32)
            ends = random.random(COPIES) < 0.01
            actions = random.uniform(-1, 1, (3, COPIES, 1)).astype(np.float32)
            rewards = random.standard_normal(COPIES, np.float32)
            state = random.standard_normal((COPIES, team.state_size))
            writer.write(
                JointStep(
                    step=number,
                    observations=(seen,) * 3,
                    actions=tuple(actions),
                    rewards=(rewards,) * 3,
                    next_observations=(successors,) * 3,
                    terminated=ends,
                    truncated=never,
                    exploring=(False,) * 3,
                    episode_seeds=seeds,
                    state=state,
                )
            )
            first = random.standard_normal((COPIES, 11), np.float32)
            seen = np.where(ends[:, np.newaxis], first, successors)
            seeds = np.where(ends, seeds + COPIES, seeds)
            if number % 1000 == 999:
                report(number + 1, steps)
    return writer.finish(dict.fromkeys(team.names, "0" * 16))


def export(log: Path, form: str, steps: int) -> Cost:
    """Run the command on the first `steps` steps."""
    out = log.with_name(form)
    command = [sys.executable, "-m", "otc_dist.replay", str(log), "--export", form]
    command += ["--out", str(out), "--steps", f"0:{steps}"]
    start = time.perf_counter()
    child = os.posix_spawn(sys.executable, command, os.environ)
    _, status, usage = os.wait4(child, 0)
    seconds = time.perf_counter() - start
    if status:
        raise SystemExit(f"{form}: the export has failed")
    disk = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    shutil.rmtree(out)
    return Cost(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, disk / 1e6)


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--transitions", type=int, default=1_000_000, help="%(default)s")
    parser.add_argument("--only", default=",".join(FORMATS), help="formats, with commas between")
    arguments = parser.parse_args(argv)
    limit = SECONDS * arguments.transitions / 1e6
    with tempfile.TemporaryDirectory(prefix="export", dir=".") as name:
        log = record(Path(name) / "log.mcap", arguments.transitions)
        print(f"{arguments.transitions:,} transitions, {log.stat().st_size / 1e6:,.0f} MB of log")
        print(f"{'':8} {'s':>6} {'cpu s':>6} {'disk MB':>8} {'peak MB':>8} {'of 1/4':>8}")
        for form in arguments.only.split(","):
            some = export(log, form, arguments.transitions // COPIES // 4)
            cost = export(log, form, arguments.transitions // COPIES)
            met = cost.seconds <= limit and cost.memory <= GROWTH * some.memory
            print(
                f"{form:8} {cost.seconds:6.1f} {cost.processor:6.1f} {cost.disk:8,.0f}"
                f" {cost.memory:8,.0f} {some.memory:8,.0f}   at most {limit:g} s and"
                f" {GROWTH:g} x the memory: {'met' if met else 'MISSED'}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    run_main(main)
