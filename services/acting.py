"""Which policies act: in an evaluation, or in a deployment, they must stay the same."""

import logging
from collections.abc import Mapping

from .process import FailureError

log = logging.getLogger(__name__)


def confirmed(
    begun: Mapping[str, str], acting: Mapping[str, str], where: str, moved: bool
) -> Mapping[str, str]:
    """Agent -> digest of the policy that acts, now that `acting` do, where `begun` did.

    A policy changes if its checkpoint was lost and it was trained again: never to another one on
    one kind of processor, and to another one where the run has `moved` to another kind.

    Args:
        begun: empty before the first step.
        where: for the line that reports a change, as "deployment 2".

    Raises:
        FailureError: one has changed, and the run has not moved.
    """
    if not begun or begun == acting:
        return acting
    for agent, policy in acting.items():
        if begun[agent] == policy:
            continue
        changed = (
            f"{agent} acts by another policy ({policy}) than it began {where} with"
            f" ({begun[agent]}): its checkpoint was lost, and its training"
        )
        if not moved:
            raise FailureError(
                f"{changed} did not repeat itself to the bit, as it does on one kind of processor"
                " and with the same libraries"
            )
        log.warning(
            "%s comes out differently on this kind of processor; the run continues", changed
        )
    return acting
