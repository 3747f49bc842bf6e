"""Environments by name. A new family of tasks is one more line in `_FAMILIES`."""

from collections.abc import Callable
from dataclasses import dataclass

from otc_dist.envs import robot_specs
from otc_dist.envs.base import BatchedEnv
from otc_dist.errors import unknown
from otc_dist.spec import Task, TeamSpec


@dataclass(frozen=True)
class _Family:
    """Environments that share an implementation; its simulator is imported only by `make`."""

    env_ids: tuple[str, ...]
    team_spec: Callable[[str], TeamSpec]
    make: Callable[[str, int], BatchedEnv]
    reference_returns: Callable[[str], tuple[float, float]] | None  # of a random and an expert team


def _make_robot(env_id: str, copies: int) -> BatchedEnv:
    from otc_dist.envs.robots import RobotEnv

    return RobotEnv(env_id, copies)


_FAMILIES = (
    _Family(
        tuple(robot_specs.PARTITIONS),
        robot_specs.team_spec,
        _make_robot,
        robot_specs.reference_returns,
    ),
)
_FAMILY_OF = {env_id: family for family in _FAMILIES for env_id in family.env_ids}


def _family(env_id: str) -> _Family:
    if env_id not in _FAMILY_OF:
        raise unknown("environment", env_id, _FAMILY_OF)
    return _FAMILY_OF[env_id]


def env_ids() -> tuple[str, ...]:
    """All known environment ids, family by family."""
    return tuple(_FAMILY_OF)


def team_spec(env_id: str) -> TeamSpec:
    """The team of an environment, without starting a simulator. Raises UserError if unknown."""
    return _family(env_id).team_spec(env_id)


def make(env_id: str, copies: int) -> BatchedEnv:
    """`copies` copies of an environment that step together; none has a state before `reset`.

    Raises:
        UserError: unknown environment; the message suggests the nearest known one.
        ValueError: fewer than one copy.
    """
    return _family(env_id).make(env_id, copies)


def task(env_id: str) -> Task | None:
    """Reward and termination as one agent can tell them; None if the task does not say."""
    del env_id
    return None


def normalised_score(env_id: str, returns: float) -> float | None:
    """100 (return - random) / (expert - random), as D4RL reports: 0 is random, 100 is expert.

    None for a task that has no published reference returns. Raises UserError if unknown.
    """
    reference_returns = _family(env_id).reference_returns
    if reference_returns is None:
        return None
    random, expert = reference_returns(env_id)
    return 100.0 * (returns - random) / (expert - random)
