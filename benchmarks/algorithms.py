"""What does one update of each algorithm cost, beside d3rlpy's way and CORL's way?

    python benchmarks/algorithms.py [--rounds 7] [--only bcq,cql]

Ours is `Learner.tune`, compiled, with uniform sampling. d3rlpy's way is d3rlpy itself: a
minibatch of its replay buffer, then its `update`, as its `fit` does, also without the sampling.
CORL's way is a plain eager loop of the same equations as ours (plain/), and JAX's a jitted loop of
updates with the sampling inside (jax_peer.py). All have the same data,
batch and hidden sizes, those of an agent of hopper-3x1, or of 5m_vs_6m for discrete actions,
and take turns of 80 updates on one thread (timing.py). BREMEN is timed twice: its updates of
models and clone alone, and with its improvements of the policy, of which a deployment's 2,000
updates are followed by 50.

Where the peers' equations differ from the algorithms' sources, in what it costs: d3rlpy's
discrete CQL has no masks of available actions and copies its target now and then; its BCQ
decodes actions without the final tanh. d3rlpy has no BREMEN; beside its updates are timed the
matrix products that any code must do for them, which take most of their time. CORL's own files
have three hidden layers in AWAC and CQL, where Table 3 has two; it has no BCQ, discrete CQL or
BREMEN.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import d3rlpy_peer
import jax_peer
import memory
import plain
import torch
from plain.bremen import BremenProducts, PlainBremen
from plain.parts import Training
from timing import (
    ENVS,
    OFFLINE,
    ONLINE,
    UPDATES,
    Timed,
    describe,
    interleave,
    random_data,
    repeated,
    say,
    sections,
    tuning,
)

from otc_dist.algorithms.bremen.algorithm import BremenSection
from otc_dist.envs import registry
from otc_dist.learner.learner import Learner
from otc_dist.spec import AgentSpec
from otc_dist.steps.engine import Engine
from otc_dist.terminal.errors import run_main, unknown
from otc_dist.transitions import Transitions

TARGETS = {"CORL's way": 2.5, "d3rlpy": 2.5, "JAX": 1.0}  # times as fast as each
UPDATES_AN_IMPROVEMENT = 40  # BREMEN's defaults: L = 2,000 updates, then 50 improvements


@dataclass
class Entry:
    """One algorithm: ours, and beside it the peers that run here and why others do not."""

    name: str
    ours: Timed
    peers: list[Timed]
    absent: dict[str, str]


def entries(name: str, rounds: int) -> list[Entry]:
    return [entry(name, rounds)] if name != "bremen" else bremen(rounds)


def entry(name: str, rounds: int) -> Entry:
    of_modules = plain.version(name)
    learner, spec, data, online = tuned(name, rounds)
    section = learner.description.algorithm
    made = Entry(name, Timed(name, tuning(learner, online)), [], {})
    peer = of_modules(section, spec.observation_size, spec.choices or spec.action_size)
    training = Training(peer, data, section.batch_size)
    made.peers.append(Timed("CORL's way", repeated(training.update)))
    if reason := jax_peer.missing(name):
        made.absent["JAX"] = reason
    else:
        made.peers.append(Timed("JAX", jax_peer.JaxPeer(section, spec, data).turn))
    if reason := d3rlpy_peer.missing(name):
        made.absent["d3rlpy"] = reason
    else:
        theirs = d3rlpy_peer.Peer(section, spec, data)
        made.peers.append(Timed("d3rlpy", repeated(theirs.update)))
        made.peers.append(Timed("  its sampling left out", repeated(theirs.again)))
    return made


def bremen(rounds: int) -> list[Entry]:
    """Its updates alone, and with their share of improvements."""
    made = []
    for name, count in (("bremen", 0), ("bremen, improving", UPDATES // UPDATES_AN_IMPROVEMENT)):
        learner, spec, data, online = tuned("bremen", rounds, f"algorithm.improvements={count}")
        section = learner.description.algorithm
        assert isinstance(section, BremenSection)
        sizes = spec.observation_size, spec.action_size
        peer = PlainBremen(section, *sizes, registry.task(learner.description.env.id))
        training = Training(peer, data, section.batch_size)
        peer.fit_statistics(training.fields)
        if count:
            peers = [Timed("CORL's way", repeated(partial(tune, peer, training), times=count))]
        else:
            products = BremenProducts(section, *sizes)
            peers = [
                Timed("CORL's way", repeated(training.update)),
                Timed("  matrix products alone", repeated(products.update)),
            ]
        ours = Timed(name, tuning(learner, online))
        absent = {"JAX": jax_peer.missing("bremen"), "d3rlpy": d3rlpy_peer.missing("bremen")}
        made.append(Entry(name, ours, peers, absent))
    return made


def tune(peer: PlainBremen, training: Training) -> None:
    for _ in range(UPDATES_AN_IMPROVEMENT):
        training.update()
    peer.improve(training.sample()[0], peer.sample_improvement_noise(training.batch_size))


def tuned(
    name: str, rounds: int, *assignments: str
) -> tuple[Learner, AgentSpec, Transitions, Transitions]:
    """A learner of some random B_0, which has compiled; its agent, B_0, and D_k."""
    env_id = ENVS[sections()[name].discrete]
    description = describe(
        env_id,
        rounds,
        f"algorithm.name={name}",
        "sampling.name=uniform",
        "engine.name=compiled",
        *assignments,
    )
    spec = registry.team_spec(env_id).agents[0]
    data, online = random_data(spec, OFFLINE[env_id], 0), random_data(spec, ONLINE, 1)
    say(f"compiling {name}, up to a minute the first time")
    learner = Learner(description, spec, data, registry.task(env_id))
    learner.pretrain(lambda progress: None, lambda: None)
    return learner, spec, data, online


def rates() -> str:
    """What one core makes of the products that large networks consist of.

    MKL computes the peers' and oneDNN ours. Where both are equally fast, only what lies between
    the products can be saved.
    """
    x, weight = torch.randn(128, 256), torch.randn(256, 256)
    ours = Engine("compiled", "own").fuse(_multiply)
    found = []
    for name, multiply in (("MKL", lambda: x @ weight), ("oneDNN", lambda: ours(x, weight))):
        milliseconds = min(repeated(multiply)(turn) for turn in range(20))
        found.append(f"{name} {2 * 128 * 256**2 / milliseconds / 1e6:.0f}")
    return f"GFLOP/s: {', '.join(found)}"


def _multiply(left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    return left @ right


def table(entries: Sequence[Entry]) -> str:
    lines = [f"{'one update':<28}{'ms':>8}{'best':>8}{'÷ ours':>9}  target"]
    for made in entries:
        lines.append(_line(f"{made.name}, ours", made.ours))
        for peer in made.peers:
            ratio = peer.times_as_slow_as(made.ours)
            verdict = _verdict(ratio, TARGETS[peer.name]) if peer.name in TARGETS else ""
            lines.append(f"{_line(f'  {peer.name}', peer)}{ratio:9.2f}  {verdict}".rstrip())
        lines += [f"  {peer}: {reason}" for peer, reason in made.absent.items()]
    return "\n".join(lines)


def _line(name: str, row: Timed) -> str:
    return f"{name:<28}{row.median:8.2f}{row.best:8.2f}"


def _verdict(ratio: float, target: float) -> str:
    return f">= {target}  {'met' if ratio >= target else 'MISSED'}"


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

    made = [each for name in names for each in entries(name, arguments.rounds)]
    interleave([row for each in made for row in (each.ours, *each.peers)], arguments.rounds)
    print(f"batch 128, torch {torch.__version__}, one thread; {rates()}")
    print(table(made))
    print(memory.table(names))
    return 0


if __name__ == "__main__":
    run_main(main)
