"""Where a learner meets the env host: at its socket or endpoint, or at a router."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from otc_dist.bus.handshake import agree
from otc_dist.bus.messages import Status
from otc_dist.bus.session import Session
from otc_dist.bus.status import Heartbeat
from otc_dist.bus.wire import Rejections

from .process import Run, endpoint_at, patience


@contextmanager
def open_bus(
    run: Run, agent: str, arguments: argparse.Namespace, rejections: Rejections
) -> Iterator[Session]:
    """A session with the env host, which serves this very run.

    Raises:
        UserError: as `Session.connect` and `agree`, or a bad endpoint or certificate.
        GaveUpError: nobody answers in time.
    """
    there = arguments.connect
    endpoint = endpoint_at(there, agent, arguments) if there else run.local_bus
    deadline = patience(run, arguments)
    with Session.connect(endpoint, run.maximum_payload, deadline) as session:
        router = bool(run.description.bus.router)
        if there and not router:  # the env host has let us in, so it can answer
            deadline = run.description.bus.answer_deadline
        waiting = Status(agent, "waiting")
        with Heartbeat(session, run.keys, agent, rejections, lambda: waiting):
            agree(session, run.keys, run.spec, deadline, rejections, shared=router)
        yield session
