"""Where the env host meets the learners: at itself, or at a router as one client among others."""

import argparse

from otc_dist.bus.access import host_rules
from otc_dist.bus.handshake import claim
from otc_dist.bus.keys import HOST
from otc_dist.bus.session import Session

from .process import Run, endpoint_at, patience


def open_bus(run: Run, arguments: argparse.Namespace) -> Session:
    """The centre of the bus, or a client of a router.

    Whatever the learners use, the launcher beside this process observes the run through the socket
    of this machine.

    Raises:
        UserError: as `Session.listen` and `Session.connect`, or a bad endpoint or certificate.
        GaveUpError: another env host serves this very run at the router.
    """
    maximum = run.maximum_payload
    if arguments.connect:
        router = endpoint_at(arguments.connect, HOST, arguments)
        session = Session.connect(router, maximum, patience(run, arguments))
        try:
            claim(session, run.keys)  # where one listens, another cannot
        except BaseException:
            session.close()
            raise
        return session
    local = run.local_bus
    if not arguments.listen:
        return Session.listen([local], maximum)
    endpoint = endpoint_at(arguments.listen, HOST, arguments)
    access = host_rules(run.keys, run.team.names) if endpoint.identity else None
    return Session.listen([endpoint, local], maximum, access)
