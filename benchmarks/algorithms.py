"""What does one update of each algorithm cost, beside d3rlpy's way and CORL's way?

    python benchmarks/algorithms.py [--rounds 7] [--only bcq,cql]

Ours is `Learner.tune`, compiled, with uniform sampling. d3rlpy's way is d3rlpy itself: a
minibatch of its replay buffer, then its `update`, as its `fit` does, also without the sampling.
CORL's way is a plain eager loop of the same equations as ours (plain/). All have the same data,
batch and hidden sizes, those of an agent of hopper-3x1, or of 5m_vs_6m for discrete actions,
and take turns of 100 updates on one thread (timing.py).

Where the peers' equations differ from the algorithms' sources, in what it costs: d3rlpy's
discrete CQL has no masks of available actions and copies its target now and then; its BCQ
decodes actions without the final tanh. d3rlpy has no BREMEN, of which the minibatch update is
timed, without the improvement of the policy: beside the matrix products that any code must do
for it, which take most of its time. CORL's own files have three hidden layers in AWAC
and CQL, where Table 3 has two; it has no BCQ, discrete CQL or BREMEN.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import memory
import torch
from d3rlpy_peer import Peer, missing
from plain.awac import PlainAwac
from plain.bcq import PlainBcq
from plain.bremen import BremenProducts, PlainBremen
from plain.cql import PlainCql
from plain.discrete_cql import PlainDiscreteCql
from plain.td3bc import PlainTd3Bc
from timing import (
    ENVS,
    OFFLINE,
    ONLINE,
    Timed,
    describe,
    interleave,
    random_data,
    repeated,
    say,
    sections,
    tuning,
)

from otc_dist.envs import registry
from otc_dist.errors import run_main, unknown
from otc_dist.learner import Learner

TARGET = 2.5  # times as fast as each peer
PLAIN = {
    "bcq": PlainBcq,
    "awac": PlainAwac,
    "cql": PlainCql,
    "discrete-cql": PlainDiscreteCql,
    "td3bc": PlainTd3Bc,
    "bremen": PlainBremen,
}


@dataclass
class Entry:
    """One algorithm: ours, and beside it the peers that run here and why others do not."""

    name: str
    ours: Timed
    peers: list[Timed]
    absent: dict[str, str]


def entry(name: str, rounds: int) -> Entry:
    assignments = [
        f"algorithm.name={name}",
        "sampling.name=uniform",
        "engine.name=compiled",
    ]
    env_id = ENVS[sections()[name].discrete]
    if name == "bremen":  # they follow the updates, and are not timed
        assignments.append("algorithm.improvements=0")
    description = describe(env_id, rounds, *assignments)
    section, spec = description.algorithm, registry.team_spec(env_id).agents[0]
    data, online = random_data(spec, OFFLINE[env_id], 0), random_data(spec, ONLINE, 1)
    say(f"compiling {name}, up to a minute the first time")
    learner = Learner(description, spec, data, registry.task(env_id))
    learner.pretrain(lambda progress: None, lambda: None)

    made = Entry(name, Timed(name, tuning(learner, online)), [], {})
    plain = PLAIN[name](section, spec, data)
    made.peers.append(Timed("CORL's way", repeated(plain.update)))
    if name == "bremen":
        products = BremenProducts(section, spec)
        made.peers.append(Timed("  matrix products alone", repeated(products.update)))
    if reason := missing(name):
        made.absent["d3rlpy"] = reason
    else:
        peer = Peer(section, spec, data)
        made.peers.append(Timed("d3rlpy", repeated(peer.update)))
        made.peers.append(Timed("  its sampling left out", repeated(peer.again)))
    return made


def table(entries: Sequence[Entry]) -> str:
    lines = [f"{'one update':<28}{'ms':>8}{'best':>8}{'÷ ours':>9}  target"]
    for made in entries:
        lines.append(_line(f"{made.name}, ours", made.ours))
        for peer in made.peers:
            ratio = peer.times_as_slow_as(made.ours)
            verdict = "" if peer.name.startswith(" ") else _verdict(ratio)
            lines.append(f"{_line(f'  {peer.name}', peer)}{ratio:9.2f}  {verdict}".rstrip())
        lines += [f"  {peer}: {reason}" for peer, reason in made.absent.items()]
    return "\n".join(lines)


def _line(name: str, row: Timed) -> str:
    return f"{name:<28}{row.median:8.2f}{row.best:8.2f}"


def _verdict(ratio: float) -> str:
    return f">= {TARGET}  {'met' if ratio >= TARGET else 'MISSED'}"


def main(argv: list[str]) -> int:
    known = sections()
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n", maxsplit=1)[0],
        epilog="'ms' is the median of all turns, 'best' their minimum, '÷ ours' the median of the"
        " ratios within a round.",
    )
    parser.add_argument("--rounds", type=int, default=7, help="turns of each (7)")
    parser.add_argument("--only", default=",".join(known), help="names, with commas between")
    arguments = parser.parse_args(argv)
    names = arguments.only.split(",")
    for name in names:
        if name not in known:
            raise unknown("algorithm", name, known)
    torch.set_num_threads(1)

    entries = [entry(name, arguments.rounds) for name in names]
    interleave([row for made in entries for row in (made.ours, *made.peers)], arguments.rounds)
    print(f"batch 128, torch {torch.__version__}, one thread")
    print(table(entries))
    print(memory.table(names))
    return 0


if __name__ == "__main__":
    run_main(main)
