"""What does somebody who subscribes to everything and never reads cost a run?

    python benchmarks/observer.py [--rounds 7] [--steps 2000]

The lock-step of benchmarks/lockstep.py (three agents, E = 1), without and with an observer of all
keys, in pairs one after the other; the observer is a process of its own with Zenoh's own settings,
as a stranger's would be:

    deaf     its handler never returns, so that Zenoh can hand on nothing more
    frozen   it is stopped (SIGSTOP) as soon as it has subscribed
    reading  for comparison: it takes everything, which costs processor time of the same machine

Prints the ratio of the times a lock-step, median and range over the rounds, and the longest single
step in any round. At most 1.05 is allowed for those that do not read. That needs a machine with
little else to do. `--puts` needs none: how long it takes to publish 20,000 messages while such an
observer is there, and how often the publishing thread had to wait (voluntary context switches).
"""

import argparse
import multiprocessing as mp
import os
import resource
import signal
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

from lockstep_transports import Step, ours

from otc_dist.bus.endpoints import Endpoint, local_endpoint, remove_local_endpoint
from otc_dist.bus.links import QUICK_PAYLOAD
from otc_dist.bus.session import Session

LIMIT = 1.05
MESSAGE, PUTS = bytes(300), 20_000
KINDS = ("deaf", "frozen", "reading")


def observe(endpoint: str, kind: str, ready: Connection) -> None:
    import zenoh

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    heard = threading.Event()

    def on_sample(sample: object) -> None:
        if not heard.is_set():
            heard.set()
            ready.send("heard")
        if kind == "deaf":
            threading.Event().wait()

    with zenoh.open(config) as session:
        direct = zenoh.handlers.Callback(on_sample, indirect=False)
        session.declare_subscriber("otc/**", direct)
        threading.Event().wait()


@contextmanager
def observer(endpoint: str, kind: str, step: Callable[[], None]) -> Iterator[None]:
    """An observer that has been heard to hear: lock-steps go on until it does."""
    context = mp.get_context("spawn")
    ours_end, theirs = context.Pipe()
    process = context.Process(target=observe, args=(endpoint, kind, theirs), daemon=True)
    process.start()
    try:
        while not ours_end.poll():
            step()
        if kind == "frozen":
            assert process.pid is not None
            os.kill(process.pid, signal.SIGSTOP)
        yield
    finally:
        process.kill()
        process.join()


class Counter:
    """Lock-steps, numbered."""

    def __init__(self, step: Step) -> None:
        self._step, self._number = step, 0

    def __call__(self) -> None:
        self._step(self._number)
        self._number += 1

    def seconds(self, steps: int) -> tuple[float, float]:
        """Seconds a step, and of the longest."""
        longest, start = 0.0, time.perf_counter()
        before = start
        for _ in range(steps):
            self()
            now = time.perf_counter()
            longest, before = max(longest, now - before), now
        return (before - start) / steps, longest


def puts() -> None:
    """Print how long `put` takes with each observer."""
    with tempfile.TemporaryDirectory(prefix="observer") as name:
        endpoint = local_endpoint(Path(name))
        with Session.listen([Endpoint(endpoint)], QUICK_PAYLOAD) as session:
            put = session.publisher("otc/run/agent_0/observation")
            for kind in ("none", *KINDS):
                with ExitStack() as watched:
                    if kind != "none":
                        say = partial(put, MESSAGE)
                        watched.enter_context(observer(endpoint, kind, say))
                    before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
                    times = sorted(_timed(put) for _ in range(PUTS))
                    waits = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before
                most = 1e6 * times[99 * PUTS // 100]
                print(
                    f"{kind:8} put: median {1e6 * times[PUTS // 2]:.1f} us,"
                    f" 99 of 100 within {most:.1f} us; waited {waits} times"
                )
        remove_local_endpoint(endpoint)


def _timed(put: Callable[[bytes], None]) -> float:
    start = time.perf_counter()
    put(MESSAGE)
    return time.perf_counter() - start


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--steps", type=int, default=2000, help="lock-steps a measurement")
    parser.add_argument("--puts", action="store_true", help="time what is published, no lock-steps")
    arguments = parser.parse_args()
    if arguments.puts:
        puts()
        return 0
    ratios: dict[str, list[float]] = {kind: [] for kind in KINDS}
    longest: dict[str, float] = dict.fromkeys(("none", *KINDS), 0.0)
    alone: list[float] = []
    with tempfile.TemporaryDirectory(prefix="observer") as name, ours(Path(name)) as step:
        count = Counter(step)
        count.seconds(200)
        for _ in range(arguments.rounds):
            for kind in KINDS:
                without, slowest = count.seconds(arguments.steps)
                longest["none"] = max(longest["none"], slowest)
                alone.append(without)
                with observer(local_endpoint(Path(name)), kind, count):
                    seconds, slowest = count.seconds(arguments.steps)
                ratios[kind].append(seconds / without)
                longest[kind] = max(longest[kind], slowest)
    print(
        f"no observer: {1e6 * statistics.median(alone):,.0f} us a lock-step,"
        f" longest {1e3 * longest['none']:,.0f} ms"
    )
    missed = False
    for kind, values in ratios.items():
        median = statistics.median(values)
        line = f"{kind:8} {median:.3f} ({min(values):.3f}..{max(values):.3f}),"
        line += f" longest {1e3 * longest[kind]:,.0f} ms"
        if kind != "reading":
            missed |= median > LIMIT
            line += f"; at most {LIMIT}: {'met' if median <= LIMIT else 'MISSED'}"
        print(line)
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
