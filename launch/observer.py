"""Listens to the processes' statuses. It only looks: a run goes on whether it connects or not."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from otc_dist.bus.endpoints import Door, local_endpoint
from otc_dist.bus.keys import Keys
from otc_dist.bus.messages import Status
from otc_dist.bus.session import Session
from otc_dist.bus.status import StatusBoard
from otc_dist.bus.wire import Rejections
from otc_dist.errors import UserError

from .plan import Plan


@contextmanager
def observing(plan: Plan, run: str, take: Callable[[Status], None]) -> Iterator[None]:
    """While entered, call `take`, from another thread, with every status of every process."""
    over = threading.Event()
    # A thread of its own, since the env host may take seconds before it listens.
    listener = threading.Thread(target=_listen, args=(plan, run, take, over), daemon=True)
    listener.start()
    try:
        yield
    finally:
        over.set()


def _listen(plan: Plan, run: str, take: Callable[[Status], None], over: threading.Event) -> None:
    door, maximum = Door(local_endpoint(plan.folder.root)), plan.description.bus.maximum_payload
    processes = tuple(process.name for process in plan.processes)
    while not over.is_set():
        try:
            session = Session.connect(door, maximum)
        except UserError:
            continue  # nobody listens yet
        with session:
            StatusBoard(session, Keys(run), processes, Rejections(), take)
            over.wait()
