"""What does OTC itself cost, by every distance as it is by default?

    python benchmarks/otc_cost.py [--rounds 5] [--env hopper-3x1]

Each distance beside uniform sampling, in turns, on one thread (timing.py): what an update of BCQ
takes longer, and what is computed once a deployment, before its updates: merging, fitting and
scoring all of B_k. The data are random numbers of the robot's sizes.
"""

import argparse
from dataclasses import dataclass, field

import numpy as np
import torch
from timing import OFFLINE, ONLINE, Timed, deployment, describe, interleave, random_data, say

from otc_dist.description.distances import DISTANCES
from otc_dist.envs import registry
from otc_dist.learner.learner import Learner
from otc_dist.terminal.errors import run_main

TUNING = 4000  # updates after a deployment, Table 3
TARGET = 0.1  # of an update


@dataclass
class Cost(Timed):
    """One way of sampling; and its milliseconds before the updates, turn by turn."""

    before: list[float] = field(default_factory=list)


def cost(title: str, env_id: str, rounds: int, *sampling: str) -> Cost:
    spec = registry.team_spec(env_id).agents[0]
    offline, online = random_data(spec, OFFLINE[env_id], 0), random_data(spec, ONLINE, 1)
    learner = Learner(describe(env_id, rounds, "engine.name=compiled", *sampling), spec, offline)
    learner.pretrain(lambda progress: None, lambda: None)
    whole = deployment(learner, online)

    def turn(number: int) -> float:
        before, update = whole(number)
        row.before.append(before)
        return update

    row = Cost(title, turn)
    return row


def table(rows: list[Cost]) -> str:
    uniform = rows[0]
    lines = [f"{'':<22}{'ms an update':>13}{'adds':>8}{'s a deployment':>16}{'of its updates':>16}"]
    for row in rows:
        seconds = float(np.median(row.before[1:])) / 1e3  # without the turn to warm up
        line = f"{row.name:<22}{row.median:13.2f}"
        if row is uniform:
            lines.append(f"{line}{'':>8}{seconds:16.2f}")
            continue
        added = row.times_as_slow_as(uniform) - 1
        verdict = f"<= {TARGET:.0%}  {'met' if added <= TARGET else 'MISSED'}"
        share = seconds * 1e3 / (TUNING * uniform.median)
        lines.append(f"{line}{added:>+8.1%}{seconds:16.2f}{share:>16.0%}  {verdict}")
    return "\n".join(lines)


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n", maxsplit=1)[0],
        epilog=f"'of its updates': of {TUNING:,} uniform ones.",
    )
    parser.add_argument("--env", default="hopper-3x1", help="whose agent's sizes (hopper-3x1)")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each (5)")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)

    say("compiling, half a minute the first time")
    rows = [cost("uniform", arguments.env, arguments.rounds, "sampling.name=uniform")]
    for name, facts in DISTANCES.items():
        assignment = f"sampling.distance={name}"
        rows.append(cost(f"{name}, {facts.title}", arguments.env, arguments.rounds, assignment))
    interleave(rows, arguments.rounds)
    print(f"{arguments.env}, torch {torch.__version__}, one thread")
    print(table(rows))
    return 0


if __name__ == "__main__":
    run_main(main)
