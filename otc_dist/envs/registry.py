"""Environments by name. A new family of tasks is one more line in `_FAMILIES`."""

from collections.abc import Callable
from dataclasses import dataclass

from otc_dist.envs import (
    particle_family,
    pettingzoo_adapter,
    robot_specs,
    robot_task,
    skirmish,
    smac_adapter,
    smax_adapter,
)
from otc_dist.envs.base import BatchedEnv
from otc_dist.spec import Task, TeamSpec
from otc_dist.terminal.errors import unknown
from otc_dist.transitions import Float32, Float64


@dataclass(frozen=True)
class _Family:
    """Environments that share an implementation; its simulator is imported only by `make`."""

    usual: tuple[str, ...]  # ids to list; there may be more
    knows: Callable[[str], bool]
    team_spec: Callable[[str], TeamSpec]
    make: Callable[[str, int, float | None], BatchedEnv]
    reference_returns: Callable[[str], tuple[float, float]] | None = None  # random, expert team
    task: Callable[[str], Task] | None = None
    changes: Callable[[str], bool] | None = None  # in the course of the deployments; None: never
    shares_reward: bool = True  # whether all agents get the same one, whatever happens
    # Simulator states from what agents observe, None of a task that does not show them.
    states_of: Callable[[str, Float32], Float64 | None] | None = None
    # After how many steps episodes are truncated; None: after the team's `max_episode_steps`.
    time_limit: Callable[[str], int] | None = None
    # In words, what a user should know of how the environment is driven.
    remarks: Callable[[str], tuple[str, ...]] | None = None
    sources: Callable[[str], dict[str, str]] | None = None  # None: all are this package's
    most_copies: int | None = None  # of those that nobody asked for; None: they cost little


def _make_robot(env_id: str, copies: int, progress: float | None) -> BatchedEnv:
    from otc_dist.envs.robots import RobotEnv

    del progress  # robots stay as they are
    return RobotEnv(env_id, copies)


def _make_smac(env_id: str, copies: int, progress: float | None) -> BatchedEnv:
    del progress
    return smac_adapter.SmacEnv(env_id, copies)


def _make_smax(env_id: str, copies: int, progress: float | None) -> BatchedEnv:
    del progress
    return smax_adapter.SmaxEnv(env_id, copies)


def _make_pettingzoo(env_id: str, copies: int, progress: float | None) -> BatchedEnv:
    del progress
    return pettingzoo_adapter.PettingZooEnv(env_id, copies)


def _make_skirmish(env_id: str, copies: int, progress: float | None) -> BatchedEnv:
    del progress  # battles stay as they are
    return skirmish.SkirmishEnv(env_id, copies)


_FAMILIES = (
    _Family(
        tuple(robot_specs.PARTITIONS),
        robot_specs.PARTITIONS.__contains__,
        robot_specs.team_spec,
        _make_robot,
        robot_specs.reference_returns,
        robot_task.task,
        states_of=robot_specs.states_of,
    ),
    _Family(
        particle_family.USUAL,
        particle_family.knows,
        particle_family.team_spec,
        particle_family.make,
        task=particle_family.task,
        changes=particle_family.changes,
        states_of=particle_family.states_of,
    ),
    _Family(
        tuple(skirmish.SKIRMISHES),
        skirmish.SKIRMISHES.__contains__,
        skirmish.team_spec,
        _make_skirmish,
    ),
    _Family(
        (),
        smac_adapter.knows,
        smac_adapter.team_spec,
        _make_smac,
        most_copies=smac_adapter.MOST_COPIES,
    ),
    _Family((), smax_adapter.knows, smax_adapter.team_spec, _make_smax),
    _Family(
        (),
        pettingzoo_adapter.knows,
        pettingzoo_adapter.team_spec,
        _make_pettingzoo,
        time_limit=pettingzoo_adapter.time_limit,
        remarks=pettingzoo_adapter.remarks,
        shares_reward=False,
        sources=pettingzoo_adapter.sources,
    ),
)


def _family(env_id: str) -> _Family:
    for family in _FAMILIES:
        if family.knows(env_id):
            return family
    raise unknown("environment", env_id, env_ids())


def env_ids() -> tuple[str, ...]:
    """The usual environment ids, family by family; tasks for any number of agents have more."""
    return tuple(env_id for family in _FAMILIES for env_id in family.usual)


def known(env_id: str) -> bool:
    """Whether there is such an environment."""
    return any(family.knows(env_id) for family in _FAMILIES)


def team_spec(env_id: str) -> TeamSpec:
    """The team of an environment, without starting a simulator. Raises UserError if unknown."""
    return _family(env_id).team_spec(env_id)


def make(env_id: str, copies: int, progress: float | None = None) -> BatchedEnv:
    """`copies` copies of an environment that step together; none has a state before `reset`.

    Args:
        progress: share of the deployments gone, from 0 to 1; None: offline data are made. Tasks
            that change in the course of the deployments depend on it.

    Raises:
        UserError: unknown environment; the message suggests the nearest known one.
        ValueError: fewer than one copy.
    """
    return _family(env_id).make(env_id, copies, progress)


def sources(env_id: str) -> dict[str, str]:
    """Path -> SHA-256 of the sources of an environment of the user's own; none of any other.

    Raises UserError if unknown, or if it cannot be made.
    """
    sources_of = _family(env_id).sources
    return sources_of(env_id) if sources_of else {}


def affordable(env_id: str, copies: int) -> int:
    """How many copies to make for work that would use `copies`: fewer where each is a costly one.

    Of an environment that is not known here, all of them: its logs may be looked at.
    """
    limits = (family.most_copies for family in _FAMILIES if family.knows(env_id))
    most = next(limits, None)
    return copies if most is None else min(copies, most)


def task(env_id: str) -> Task | None:
    """Reward and termination as one agent can tell them; None if the task does not say."""
    task_of = _family(env_id).task
    return task_of(env_id) if task_of else None


def remarks(env_id: str) -> tuple[str, ...]:
    """In words, what is done to an environment's actions; of most, nothing.

    Raises UserError if unknown.
    """
    remarks_of = _family(env_id).remarks
    return remarks_of(env_id) if remarks_of else ()


def time_limit(env_id: str) -> int:
    """After how many steps the task truncates an episode, and no earlier.

    0 of an environment of the user's own that does not say: it may do so at any step.
    """
    limit_of = _family(env_id).time_limit
    return limit_of(env_id) if limit_of else team_spec(env_id).max_episode_steps


def shares_reward(env_id: str) -> bool:
    """Whether all agents are sure to get one reward. An environment of the user's own may give
    each its own, which only its data tell.
    """
    return _family(env_id).shares_reward or len(team_spec(env_id).agents) == 1


def changes(env_id: str) -> bool:
    """Whether deployment k is played in another environment than those before it, which depends
    on how many deployments there are.
    """
    changes_of = _family(env_id).changes
    return changes_of is not None and changes_of(env_id)


def states_of(env_id: str, observations: Float32) -> Float64 | None:
    """Simulator states (N, state_size), for `set_state`, in which `observations` (N, s) are made at
    the first step of an episode. None for a task whose observations do not tell its state.

    Raises UserError if unknown.
    """
    states = _family(env_id).states_of
    return states(env_id, observations) if states else None


def normalised_score(env_id: str, returns: float) -> float | None:
    """100 (return - random) / (expert - random), as D4RL reports: 0 is random, 100 is expert.

    None for a task that has no published reference returns. Raises UserError if unknown.
    """
    reference_returns = _family(env_id).reference_returns
    if reference_returns is None:
        return None
    random, expert = reference_returns(env_id)
    return 100.0 * (returns - random) / (expert - random)
