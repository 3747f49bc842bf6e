"""Before anything else, learner and env host make sure that they mean the same run."""

import logging
import time

from otc_dist.bus.keys import HOST, Keys
from otc_dist.bus.lockstep import GaveUpError
from otc_dist.bus.replies import RunSpec, decode_spec, encode_spec
from otc_dist.bus.session import Session
from otc_dist.bus.wire import RejectedError, Rejections
from otc_dist.terminal.errors import UserError

log = logging.getLogger(__name__)

_RETRY = 0.2  # seconds
_PATIENCE = 5.0  # seconds for the answer to whether somebody is there; there is one at once
_LEAVING = 10.0  # seconds in which an env host's token goes after its end, or its machine's


def claim(session: Session, keys: Keys) -> None:
    """Make sure that no other env host serves the very same run at this router.

    Raises:
        GaveUpError: one does; that of a predecessor that has just died goes by itself.
    """
    end = time.monotonic() + _LEAVING
    while session.is_alive(keys.alive(HOST), _PATIENCE):
        if time.monotonic() > end:
            raise GaveUpError(
                f"another env host of run {keys.run!r} is at work at this router, by the same"
                " description: end one of them, or give one another name or seed"
            )
        time.sleep(_RETRY)


def offer(session: Session, keys: Keys, spec: RunSpec) -> None:
    """Answer the learners' queries for the run's spec."""
    reply = encode_spec(keys.run, spec)
    session.answer(keys.spec, lambda _: reply)


def agree(
    session: Session,
    keys: Keys,
    mine: RunSpec,
    deadline: float,
    rejections: Rejections,
    shared: bool = False,
) -> None:
    """Wait for the env host's spec and compare it with mine.

    Args:
        shared: at a router, where an env host of another description may be that of another run:
            it is logged, and the right one is waited for.

    Raises:
        UserError: no env host of this run within `deadline` seconds, another protocol version,
            or another environment or description.
    """
    end, reason, logged = time.monotonic() + deadline, "", ""
    while True:
        other: RunSpec | None = None
        for reply in session.ask_all(keys.spec, timeout=1.0):
            try:
                theirs = decode_spec(reply, keys.run)
            except RejectedError as rejected:
                if rejected.reason == "version" and not shared:
                    raise UserError(f"the env host's spec is refused: {rejected}") from None
                rejections.count(rejected)
                reason = f" with a spec that can be accepted ({rejected})"
                continue
            if theirs == mine:
                return
            other = theirs
        if other is not None:
            reason = f": {_difference(other, mine)}"
            if not shared:
                raise UserError(_difference(other, mine))
            if reason != logged:
                logged = reason
                log.warning("%s; waiting for ours", _difference(other, mine))
        if time.monotonic() > end:
            raise UserError(
                f"no env host of run {keys.run!r} answered for {deadline:g} s{reason}:"
                " do both sides run a description of the same name and seed?"
            )
        time.sleep(_RETRY)


def _difference(theirs: RunSpec, mine: RunSpec) -> str:
    if theirs.description != mine.description:
        return (
            f"the env host runs another description ({theirs.description}) than this learner"
            f" ({mine.description}): give both the same description, --set and --seed"
        )
    return (
        f"the env host's {theirs.env_id} is not this learner's {mine.env_id}:"
        " install the same version of otc_dist on both"
    )
