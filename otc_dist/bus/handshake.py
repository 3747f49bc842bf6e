"""Before anything else, learner and env host make sure that they mean the same run."""

import time

from otc_dist.bus.keys import Keys
from otc_dist.bus.replies import RunSpec, decode_spec, encode_spec
from otc_dist.bus.session import Session
from otc_dist.bus.wire import RejectedError, Rejections
from otc_dist.errors import UserError

_RETRY = 0.2  # seconds


def offer(session: Session, keys: Keys, spec: RunSpec) -> None:
    """Answer the learners' queries for the run's spec."""
    reply = encode_spec(keys.run, spec)
    session.answer(keys.spec, lambda _: reply)


def agree(
    session: Session, keys: Keys, mine: RunSpec, deadline: float, rejections: Rejections
) -> None:
    """Wait for the env host's spec and compare it with mine.

    Raises:
        UserError: no env host of this run within `deadline` seconds, another protocol version,
            or another environment or description.
    """
    end, reason = time.monotonic() + deadline, ""
    while True:
        reply = session.ask(keys.spec, {}, timeout=1.0)
        try:
            if reply is not None:
                theirs = decode_spec(reply, keys.run)
                break
        except RejectedError as rejected:
            if rejected.reason == "version":
                raise UserError(f"the env host's spec is refused: {rejected}") from None
            rejections.count(rejected)
            reason = f" with a spec that can be accepted ({rejected})"
        if time.monotonic() > end:
            raise UserError(
                f"no env host of run {keys.run!r} answered for {deadline:g} s{reason}:"
                " do both sides run a description of the same name and seed?"
            )
        time.sleep(_RETRY)
    if theirs.description != mine.description:
        raise UserError(
            f"the env host runs another description ({theirs.description}) than this learner"
            f" ({mine.description}): give both the same description, --set and --seed"
        )
    if theirs != mine:
        raise UserError(
            f"the env host's {theirs.env_id} is not this learner's {mine.env_id}:"
            " install the same version of otc_dist on both"
        )
