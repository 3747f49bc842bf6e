"""What do pictures of a deployment cost: in a finished log, as a page, as a film?

    python benchmarks/pictures.py [--steps 1000]

One copy of each task with random actions. *Log*: bytes a step that the steps take in the finished
file, and what Foxglove's channels add; *finishing* a log is timed with and without them. It comes
after the deployment's last step, while the learners already tune. Seconds are the processor's.
"""

import argparse
import contextlib
import io
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from otc_dist.deployment_log import finishing
from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout
from otc_dist.replay.__main__ import main as replay
from otc_dist.spec import AgentSpec
from otc_dist.terminal.errors import UserError, run_main
from otc_dist.transitions import Float32

ENVS = ("hopper-3x1", "halfcheetah-2x3", "predator-prey-3", "5m_vs_6m")


def record(env_id: str, path: Path, steps: int) -> LogWriter:
    """An unfinished log."""
    env = registry.make(env_id, 1, 0.0)
    rollout, random = Rollout(env, 0, "deployment", 1), np.random.default_rng(0)
    writer = LogWriter.create(path, LogHeader("benchmark", 1, 0, "", "", env.spec, 1))

    def action(agent: AgentSpec, seen: Float32) -> Float32:
        if agent.choices:
            available = np.flatnonzero(seen[0, -agent.choices :])
            return np.array([[random.choice(available)]], np.float32)
        size = (1, agent.action_size)
        return random.uniform(agent.action_low, agent.action_high, size).astype(np.float32)

    for _ in range(steps):
        actions = list(map(action, env.spec.agents, rollout.observations))
        writer.write(rollout.advance(actions, (False,) * len(actions)))
    env.close()
    return writer


def seconds(what: Callable[[], object]) -> float:
    """The processor's."""
    start = time.process_time()
    what()
    return time.process_time() - start


def finish_bare(path: Path) -> None:
    """Finish a log without what Foxglove shows."""
    with contextlib.ExitStack() as stack:
        stack.callback(setattr, finishing, "_add_pictures", finishing._add_pictures)
        finishing._add_pictures = lambda *_: None  # type: ignore[assignment]
        with OpenLog(partial_path(path)) as log:
            finishing.write_finished(path.with_name("bare.mcap"), log.header, log.blocks, {})


def quietly(*arguments: object) -> None:
    """The command, without what it prints."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        replay([str(argument) for argument in arguments])


def main(argv: list[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, add_help=True)
    parser.add_argument("--steps", type=int, default=1000)
    steps = parser.parse_args(argv).steps
    print(f"{steps:,} steps         log, bytes a step       finishing, us a step     page    sheet")
    print("                 steps  Foxglove           without     with    B a step        s")
    for env_id in ENVS:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "log.mcap"
            writer = record(env_id, path, steps)
            writer.close()
            bare = seconds(lambda path=path: finish_bare(path))
            full = seconds(lambda writer=writer: writer.finish({}))
            size = path.stat().st_size
            alone = path.with_name("bare.mcap").stat().st_size
            quietly(path, "--html", path.with_suffix(".html"))
            page = path.with_suffix(".html").stat().st_size
            sheet = path.with_suffix(".png")
            try:
                drawn = f"{seconds(lambda path=path, out=sheet: quietly(path, '--sheet', out)):.2f}"
            except UserError:
                drawn = "-"
            added = size - alone
            print(
                f"{env_id:<16} {alone / steps:5.0f}  {added / steps:6.0f} (+{added / alone:4.0%})"
                f"    {1e6 * bare / steps:9.0f} {1e6 * full / steps:8.0f}   {page / steps:8.0f}"
                f" {drawn:>8}"
            )
    return 0


if __name__ == "__main__":
    run_main(main)
