"""How fast is a lock-step? One host and three agents, each its own process, E = 1.

    python benchmarks/lockstep.py [--starts 5] [--rounds 7] [--steps 300]

Every transport carries the same payloads: the codec's messages for 3-agent Hopper, answered by an
11-64-64-1 network in numpy. Ours also checks every field of every message and writes every step
to a real deployment log before it sends the next; the others do neither, nor does "Zenoh alone",
our own sessions without the rest: less than that no code of ours can take. Rounds are interleaved,
and ratios are those of the same round, so that a busy machine disturbs both alike. Each peer runs
beside ours alone (Ray's daemons cost the others time), and both are started several times: on two
cores a start's ratio depends on where its processes come to lie. gRPC and Ray
are left out where they are not installed (`pip install pyzmq grpcio ray`).
"""

import argparse
import importlib.util
import statistics
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from lockstep_transports import (
    Transport,
    grpc_streaming,
    ours,
    pipe,
    pyzmq,
    ray_actors,
    zenoh_alone,
)

# Name, what it needs, how it is made, and the most that our time a step may be of its time.
PEERS: tuple[tuple[str, str, Transport, float | None], ...] = (
    ("pyzmq", "zmq", pyzmq, 1.5),
    ("Zenoh alone", "zenoh", zenoh_alone, None),
    ("multiprocessing.Pipe", "multiprocessing", pipe, None),
    # Ray before gRPC: it starts its daemons by forking, which threads of gRPC's can hang.
    ("Ray actors", "ray", ray_actors, 1 / 5),
    ("gRPC streaming", "grpc", grpc_streaming, 1 / 2),
)


def measure(make: Transport, rounds: int, length: int) -> list[tuple[float, float]]:
    """Seconds a step of ours and of a peer's, by round, after a start of both."""
    with tempfile.TemporaryDirectory(prefix="lockstep") as name, ExitStack() as running:
        steps = [running.enter_context(start(Path(name))) for start in (ours, make)]
        found = []
        for turn in range(rounds + 1):
            times = []
            for step in steps:
                start = time.perf_counter()
                for number in range(turn * length, (turn + 1) * length):
                    step(number)
                times.append((time.perf_counter() - start) / length)
            found.append((times[0], times[1]))
    return found[1:]  # the first warms up


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--starts", type=int, default=5, help="of ours and each peer (default: 5)")
    parser.add_argument("--rounds", type=int, default=7, help="after each start (default: 7)")
    parser.add_argument("--steps", type=int, default=300, help="lock-steps a round and transport")
    arguments = parser.parse_args()
    print(f"{'':20} {'us a step':>9} {'ours':>6}   ours / its (median, range, limit)")
    for peer, module, make, limit in PEERS:
        if importlib.util.find_spec(module) is None:
            print(f"{peer:20} left out: {module} is not installed")
            continue
        pairs = []
        for turn in range(arguments.starts):
            print(f"{peer}: start {turn + 1} of {arguments.starts}", file=sys.stderr)
            pairs += measure(make, arguments.rounds, arguments.steps)
        mine, its = (1e6 * statistics.median(times) for times in zip(*pairs, strict=True))
        ratios = [a / b for a, b in pairs]
        ratio = statistics.median(ratios)
        line = f"{peer:20} {its:9,.0f} {mine:6,.0f}   {ratio:.2f}"
        line += f" ({min(ratios):.2f}..{max(ratios):.2f})"
        if limit is not None:
            line += f", at most {limit:.2f}: {'met' if ratio <= limit else 'MISSED'}"
        print(line, flush=True)


if __name__ == "__main__":
    main()
