"""What does somebody who looks on cost a run: by the view, or by all of the bus and never reading?

    python benchmarks/observer.py [--rounds 7] [--steps 10000] [--kind view]

The lock-step of benchmarks/lockstep.py (three agents, E = 1), without and with somebody who looks
on, in pairs one after the other:

    view     the process of `launch --view`, and a page that asks it as often as a page may; it is
             stopped and let go on every 100 lock-steps, so that both times are of the same moments

or an observer of all keys, a process of its own with Zenoh's own settings, as a stranger's is:

    deaf     its handler never returns, so that Zenoh can hand on nothing more
    frozen   it is stopped (SIGSTOP) as soon as it has subscribed
    reading  for comparison: it takes everything, which costs processor time of the same machine

Prints the ratio of the times a lock-step, median and range over the rounds, and the longest single
step in any round. At most 1.05 is allowed for all but those that read the bus. What a browser takes
to draw the page is not in it: it may be on another machine. That needs a machine with little else
to do. `--puts` needs none: how long it takes to publish 20,000 messages while such an
observer is there, and how often the publishing thread had to wait (voluntary context switches).
"""

import argparse
import json
import multiprocessing as mp
import os
import resource
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

from lockstep_transports import Step, ours

from otc_dist.bus.endpoints import Endpoint, local_endpoint, remove_local_endpoint
from otc_dist.bus.links import QUICK_PAYLOAD
from otc_dist.bus.session import Session
from otc_dist.run.folder import RunFolder

LIMIT = 1.05
Measured = tuple[float, float]  # seconds a step, and of the longest
MESSAGE, PUTS = bytes(300), 20_000
OBSERVERS = ("deaf", "frozen", "reading")
KINDS = ("view", *OBSERVERS)
BLOCK = 100
PACE = 1.0  # seconds between two questions of a page at least: PATIENCE in live.js


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


def browse(url: str, asked: Connection) -> None:
    """What a page asks for, each time with all that it has been given to go through."""
    while True:
        with urllib.request.urlopen(f"{url}newest", timeout=60) as answer:
            asked.send(len(json.loads(answer.read())["numbers"]))
        time.sleep(2 * PACE)  # for half of which the view is stopped


class Counter:
    """Lock-steps, numbered."""

    def __init__(self, step: Step) -> None:
        self._step, self._number = step, 0

    def __call__(self) -> None:
        self._step(self._number)
        self._number += 1

    def seconds(self, steps: int) -> Measured:
        """Seconds a step, and of the longest."""
        longest, start = 0.0, time.perf_counter()
        before = start
        for _ in range(steps):
            self()
            now = time.perf_counter()
            longest, before = max(longest, now - before), now
        return (before - start) / steps, longest


def with_view(folder: Path, count: Counter, steps: int) -> tuple[Measured, Measured, int]:
    """Of the run in `folder`, without and with its view, once a page of it has been answered; and
    how often it was answered from then on.
    """
    RunFolder(folder).run_json.write_text('{"state": "running"}')
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "otc_dist.view", str(folder), "--at", str(port)]
    context = mp.get_context("spawn")
    ours_end, theirs = context.Pipe()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        url = server.stdout.readline().strip()
        page = context.Process(target=browse, args=(url, theirs), daemon=True)
        page.start()
        found: dict[signal.Signals, list[Measured]] = {signal.SIGSTOP: [], signal.SIGCONT: []}
        try:
            while not ours_end.poll():
                count()
            ours_end.recv()
            for number in range(steps // BLOCK):
                both = [*found.items()]
                for change, measured in both if number % 2 else reversed(both):
                    server.send_signal(change)
                    measured.append(count.seconds(BLOCK))
            answers = 0
            while ours_end.poll():
                answers += ours_end.recv() > 0
        finally:
            page.kill()
            page.join()
            server.kill()
    without, beside = (
        (statistics.fmean(seconds for seconds, _ in each), max(slowest for _, slowest in each))
        for each in found.values()
    )
    return without, beside, answers


def with_observer(folder: Path, count: Counter, steps: int, kind: str) -> tuple[Measured, Measured]:
    """Without and with an observer of the bus."""
    without = count.seconds(steps)
    with observer(local_endpoint(folder), kind, count):
        return without, count.seconds(steps)


def puts() -> None:
    """Print how long `put` takes with each observer."""
    with tempfile.TemporaryDirectory(prefix="observer") as name:
        endpoint = local_endpoint(Path(name))
        with Session.listen([Endpoint(endpoint)], QUICK_PAYLOAD) as session:
            put = session.publisher("otc/run/agent_0/observation")
            for kind in ("none", *OBSERVERS):
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
    parser.add_argument("--steps", type=int, default=10_000, help="lock-steps a measurement")
    parser.add_argument("--kind", choices=KINDS, action="append", help="of those (default: all)")
    parser.add_argument("--puts", action="store_true", help="time what is published, no lock-steps")
    arguments = parser.parse_args()
    if arguments.puts:
        puts()
        return 0
    kinds = arguments.kind or KINDS
    ratios: dict[str, list[float]] = {kind: [] for kind in kinds}
    longest: dict[str, float] = dict.fromkeys(("none", *kinds), 0.0)
    alone: list[float] = []
    answers = 0
    with tempfile.TemporaryDirectory(prefix="observer") as name, ours(Path(name)) as step:
        count = Counter(step)
        count.seconds(200)
        for _ in range(arguments.rounds):
            for kind in kinds:
                if kind == "view":
                    without, beside, more = with_view(Path(name), count, arguments.steps)
                    answers += more
                else:
                    without, beside = with_observer(Path(name), count, arguments.steps, kind)
                alone.append(without[0])
                ratios[kind].append(beside[0] / without[0])
                longest["none"] = max(longest["none"], without[1])
                longest[kind] = max(longest[kind], beside[1])
    print(
        f"no observer: {1e6 * statistics.median(alone):,.0f} us a lock-step,"
        f" longest {1e3 * longest['none']:,.0f} ms"
    )
    missed = False
    for kind, values in ratios.items():
        median = statistics.median(values)
        line = f"{kind:8} {median:.3f} ({min(values):.3f}..{max(values):.3f}),"
        line += f" longest {1e3 * longest[kind]:,.0f} ms"
        if kind == "view":
            line += f", {answers} answers"
        if kind != "reading":
            missed |= median > LIMIT
            line += f"; at most {LIMIT}: {'met' if median <= LIMIT else 'MISSED'}"
        print(line)
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
