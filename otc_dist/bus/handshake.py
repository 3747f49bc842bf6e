"""Before anything else, learner and env host make sure that they mean the same run."""

import time

from otc_dist.bus.keys import Keys
from otc_dist.bus.replies import RunSpec, decode_spec, encode_spec
from otc_dist.bus.session import Session
from otc_dist.bus.wire import RejectedError
from otc_dist.errors import UserError

_RETRY = 0.2  # seconds


def offer(session: Session, keys: Keys, spec: RunSpec) -> None:
    """Answer the learners' queries for the run's spec."""
    reply = encode_spec(keys.run, spec)
    session.answer(keys.spec, lambda _: reply)


def agree(session: Session, keys: Keys, mine: RunSpec, deadline: float) -> None:
    """Wait for the env host's spec and compare it with mine.

    Raises:
        UserError: no env host of this run within `deadline` seconds, another protocol version,
            or another environment or description.
    """
    end = time.monotonic() + deadline
    while (reply := session.ask(keys.spec, {}, timeout=1.0)) is None:
        if time.monotonic() > end:
            raise UserError(f"no env host of run {keys.run!r} answered for {deadline:g} s")
        time.sleep(_RETRY)
    try:
        theirs = decode_spec(reply, keys.run)
    except RejectedError as rejected:
        raise UserError(f"the env host's spec is refused: {rejected}") from None
    if theirs.description != mine.description:
        raise UserError(
            f"the env host runs another description ({theirs.description}) than this learner"
            f" ({mine.description}): copy its description.toml"
        )
    if theirs != mine:
        raise UserError(
            f"the env host's {theirs.env_id} is not this learner's {mine.env_id}:"
            " install the same version of otc_dist on both"
        )
