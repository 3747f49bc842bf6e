"""What does one update cost, and what do OTC by rank, the paper's, and Balanced Replay add to it?
And what does it cost of ten seeds at once, as `compare` trains them offline on a GPU?

    python benchmarks/update.py [--rounds 12] [--env hopper-3x1]

The peer is BCQ as it is usually written (plain/), with fused Adam. Ours is `Learner.tune`: all
of it. They take turns of 80 updates, on one thread (timing.py).

Networks, batch and minibatches are those of Table 3; the data are random numbers of the robot's
sizes, which cost what real ones do.
"""

import argparse
from dataclasses import dataclass

import torch
from plain.bcq import PlainBcq
from plain.parts import Training
from timing import (
    OFFLINE,
    ONLINE,
    UPDATES,
    Timed,
    Turn,
    at_once,
    describe,
    interleave,
    random_data,
    repeated,
    say,
    tuning,
)

from otc_dist.algorithms.bcq import BcqSection
from otc_dist.envs import registry
from otc_dist.learner.learner import Learner
from otc_dist.terminal.errors import run_main

RANK, EXACT = "sampling.acceptance=rank", "sampling.matching=exact"
SEEDS = 10
ONE_OF_SEVERAL = f"  one of {SEEDS} seeds at once"
COMPILED_TARGET, OTC_TARGET, GPU_SHARE_TARGET = 0.36, 0.6, 0.15


@dataclass
class Variant(Timed):
    """One row of the table."""

    target: float = 0.0  # at most this share of the plain version's time; 0: none


def variants(env_id: str, rounds: int) -> list[Variant]:
    spec = registry.team_spec(env_id).agents[0]
    offline, online = random_data(spec, OFFLINE[env_id], 0), random_data(spec, ONLINE, 1)

    def learner(engine: str, *sampling: str) -> Turn:
        brain = Learner(describe(env_id, rounds, f"engine.name={engine}", *sampling), spec, offline)
        brain.pretrain(lambda progress: None, lambda: None)
        return tuning(brain, online)

    def seeds(engine: str) -> Turn:
        wanted = (f"engine.name={engine}", uniform, f"offline.updates={UPDATES}")
        described = (describe(env_id, 0, *wanted, f"seed={seed}") for seed in range(SEEDS))
        return at_once([Learner(one, spec, offline) for one in described])

    section = BcqSection()
    plain = PlainBcq(section, spec.observation_size, spec.action_size, fused=True)
    peer = Training(plain, offline, section.batch_size)
    uniform, balanced = "sampling.name=uniform", "sampling.name=balanced"
    embedding, value = ("sampling.distance=embedding", RANK), ("sampling.distance=value", RANK)
    rows = [
        Variant("plain eager BCQ", repeated(peer.update)),
        Variant("ours, eager", learner("eager", uniform)),
        Variant(ONE_OF_SEVERAL, seeds("eager")),
        Variant("ours, compiled", learner("compiled", uniform), target=COMPILED_TARGET),
        Variant("  + OTC, d_e", learner("compiled", *embedding), target=OTC_TARGET),
        Variant("  + OTC, d_q", learner("compiled", *value), target=OTC_TARGET),
        Variant("  + OTC, d_e, all of D_k", learner("compiled", *embedding, EXACT)),
        Variant("  + OTC, d_q, all of D_k", learner("compiled", *value, EXACT)),
        Variant("  + Balanced Replay", learner("compiled", balanced)),
    ]
    if torch.cuda.is_available():
        rows += [
            Variant("ours, CUDA graph", learner("cuda-graph", uniform)),
            Variant(ONE_OF_SEVERAL, seeds("cuda-graph")),
            Variant("  + OTC, d_e", learner("cuda-graph", *embedding)),
            Variant("  + OTC, d_q", learner("cuda-graph", *value)),
            Variant("  + Balanced Replay", learner("cuda-graph", balanced)),
        ]
    return rows


def table(rows: list[Variant]) -> str:
    base = rows[0]
    lines = [f"{'one update':<28}{'ms':>8}{'best':>8}{'÷ plain':>9}{'adds':>10}  target"]
    for row in rows:
        ratio = row.times_as_slow_as(rows[0])
        if row.name.startswith("ours"):
            base = row
        added = ""
        if row.name.startswith("  "):
            added = f"{row.times_as_slow_as(base) - 1:+.0%}"
        verdict = ""
        if row.target:
            verdict = f"<= {row.target}  {'met' if ratio <= row.target else 'MISSED'}"
        elif base.name.endswith("graph") and row.name.startswith("  +"):
            verdict = f"OTC adds at most {GPU_SHARE_TARGET:.0%}"
        line = f"{row.name:<28}{row.median:8.2f}{row.best:8.2f}{ratio:9.2f}{added:>10}"
        lines.append(f"{line}  {verdict}".rstrip())
    return "\n".join(lines)


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n", maxsplit=1)[0],
        epilog="'ms' is the median of all turns, 'best' their minimum, '÷ plain' the median of"
        " the ratios within a round, 'adds' the same against the row of uniform sampling above it"
        " (the paper: 22% for d_e and 19% for d_q on a GPU).",
    )
    parser.add_argument("--env", default="hopper-3x1", help="whose agent's sizes (hopper-3x1)")
    parser.add_argument("--rounds", type=int, default=12, help="turns of each (12)")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)

    say("compiling, about half a minute each the first time")
    rows = variants(arguments.env, arguments.rounds)
    interleave(rows, arguments.rounds)
    gpu = torch.cuda.is_available()
    where = torch.cuda.get_device_name() if gpu else "no CUDA device here, so no CUDA graph rows"
    print(f"{arguments.env}, torch {torch.__version__}, one thread; {where}")
    print(table(rows))
    return 0


if __name__ == "__main__":
    run_main(main)
