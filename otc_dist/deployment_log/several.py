"""Several logs of one environment as one: in which order, and which do not belong together."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

from otc_dist.deployment_log.header import LogHeader
from otc_dist.terminal.errors import UserError


def in_order(headers: Mapping[Path, LogHeader]) -> list[Path]:
    """The logs whose headers these are, at least one, in order of run and deployment.

    Raises:
        UserError: logs of different teams, or two of the same deployment.
    """
    ordered = sorted(headers, key=lambda path: (headers[path].run, headers[path].deployment))
    first = ordered[0]
    team = headers[first].team
    for path in ordered:
        other = headers[path].team
        if other.env_id != team.env_id:
            raise UserError(
                f"{first} is of {team.env_id} and {path} of {other.env_id}: "
                "one data set has room for one environment"
            )
        if other != team:
            raise UserError(f"{first} and {path} are of two versions of {team.env_id}")
    for before, path in pairwise(ordered):
        mine, others = headers[path], headers[before]
        if (mine.run, mine.deployment) == (others.run, others.deployment):
            raise UserError(f"{before} and {path} are of the same deployment: give one of them")
    return ordered
