"""Listens to the processes' signs of life. It only looks: a run goes on whether it hears or not."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from otc_dist.bus.diagnosis import absence
from otc_dist.bus.endpoints import Endpoint, local_socket
from otc_dist.bus.keys import HOST, Keys
from otc_dist.bus.messages import Status
from otc_dist.bus.session import Session
from otc_dist.bus.status import StatusBoard
from otc_dist.bus.wire import Rejections
from otc_dist.terminal.errors import UserError

from ..plan.plan import Plan

_PATIENCE = 2.0  # seconds of an attempt to connect
_FAREWELL = 5.0  # seconds; a session closes within two
_LOOK = 0.2  # seconds between two looks at whether there is a link to the bus
REPORT_EVERY = 30.0  # seconds without a link, or without the env host, between lines that say so


class Token(NamedTuple):
    """A process's liveliness token has appeared or gone."""

    process: str
    alive: bool


class Link(NamedTuple):
    """The observer's own link to the bus has come or gone."""

    up: bool


class Waiting(NamedTuple):
    """There is no link to the other hosts, or no env host of this run there: whom it waits for."""

    line: str


Sign = Status | Token | Link  # of a process, or of the link by which one is heard


@contextmanager
def observing(plan: Plan, run: str, take: Callable[[Sign | Waiting], None]) -> Iterator[None]:
    """While entered, call `take`, from other threads, with every sign of every process.

    Raises:
        UserError: there is no place for the bus of this machine, or no certificate.
    """
    over, endpoint = threading.Event(), plan.placement.observed_at(plan.folder.root)
    # A thread of its own, since the env host may take seconds before it listens.
    listener = threading.Thread(target=_listen, args=(plan, run, endpoint, take, over), daemon=True)
    listener.start()
    try:
        yield
    finally:
        over.set()
        listener.join(_FAREWELL)


def nobody_of_run(plan: Plan, run: str) -> str:
    """One line if others are met where a learner is to meet its env host, but not that one: most
    likely it has another --seed. Empty if it is there, or nobody at all.
    """
    if plan.placement.role != "learner":
        return ""
    there = threading.Event()
    endpoint, maximum = (
        plan.placement.observed_at(plan.folder.root),
        plan.description.bus.maximum_payload,
    )
    try:
        session = Session.connect(endpoint, maximum, timeout=_PATIENCE)
    except UserError:
        return ""
    with session:
        keys = Keys(run, plan.description.shared_digest())
        session.watch_alive(keys.alive(HOST), lambda alive: there.set() if alive else None)
        return "" if there.wait(_PATIENCE) else _stranger(endpoint, run)


def _stranger(endpoint: Endpoint, run: str) -> str:
    return (
        f"waiting for {endpoint.locator}: no env host of run {run!r} is there; does it run this"
        " very description (its name, --set and --seed)?"
    )


def _listen(
    plan: Plan,
    run: str,
    endpoint: Endpoint,
    take: Callable[[Sign | Waiting], None],
    over: threading.Event,
) -> None:
    maximum, processes = plan.description.bus.maximum_payload, (HOST, *plan.watched)
    keys = Keys(run, plan.description.shared_digest())

    def noting(process: str) -> Callable[[bool], None]:
        return lambda alive: take(Token(process, alive))

    reported = time.monotonic()  # the launcher has said at its start who is missing
    alive = threading.Event()  # whether the env host's token is there

    def note_host(is_alive: bool) -> None:
        (alive.set if is_alive else alive.clear)()
        take(Token(HOST, is_alive))

    def report_waiting(linked: bool) -> float:
        if not plan.placement.connect or time.monotonic() < reported + REPORT_EVERY:
            return reported
        there = f"waiting for {endpoint.locator}: somebody is there, but no link comes about"
        take(Waiting(_stranger(endpoint, run) if linked else absence(endpoint) or there))
        return time.monotonic()

    while not over.is_set():
        try:
            # A folder that has gone with somebody's clean-up may be made elsewhere.
            endpoint = plan.placement.observed_at(plan.folder.root)
            socket = local_socket(endpoint.locator)
            session = Session.connect(endpoint, maximum, timeout=_PATIENCE)
        except UserError:
            reported = report_waiting(linked=False)  # nobody listens yet
            continue
        with session:
            StatusBoard(session, keys, processes, Rejections(), take)
            session.watch_alive(keys.alive(HOST), note_host)
            for process in plan.watched:
                session.watch_alive(keys.alive(process), noting(process))
            linked = False
            while not over.wait(_LOOK):
                if session.linked != linked:
                    linked = not linked
                    take(Link(linked))
                if not linked and socket is not None and not socket.exists():
                    break
                met = linked and (alive.is_set() or plan.placement.role != "learner")
                reported = time.monotonic() if met else report_waiting(linked)
