"""Environments by name. A new family of tasks is one more line in `_FAMILIES`."""

from otc_dist.envs import (
    particle_family,
    pettingzoo_adapter,
    robot_family,
    skirmish,
    smac_adapter,
    smax_adapter,
)
from otc_dist.envs.base import BatchedEnv
from otc_dist.envs.family import Family, RandomData
from otc_dist.spec import Task, TeamSpec
from otc_dist.terminal.errors import UserError, unknown
from otc_dist.transitions import Float32, Float64

_FAMILIES = (
    robot_family.FAMILY,
    particle_family.FAMILY,
    skirmish.FAMILY,
    smac_adapter.FAMILY,
    smax_adapter.FAMILY,
    pettingzoo_adapter.FAMILY,
)


def _found(env_id: str) -> Family | None:
    return next((family for family in _FAMILIES if family.knows(env_id)), None)


def _family(env_id: str) -> Family:
    family = _found(env_id)
    if family is None:
        said = str(unknown("environment", env_id, env_ids()))
        raise UserError(said if said.endswith("?") else f"{said}, or module:function of your own")
    return family


def env_ids() -> tuple[str, ...]:
    """The usual environment ids, family by family; tasks for any number of agents have more."""
    return tuple(env_id for family in _FAMILIES for env_id in family.usual)


def known(env_id: str) -> bool:
    """Whether there is such an environment."""
    return _found(env_id) is not None


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
    family = _found(env_id)
    most = family.most_copies if family else None
    return copies if most is None else min(copies, most)


def random_data(env_id: str) -> RandomData | None:
    """What random data are made of it; None where it has a source of its own, or is not known."""
    family = _found(env_id)
    return family.random_data if family else None


def task(env_id: str) -> Task | None:
    """Reward and termination as one agent can compute them; None if the task does not say."""
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
    each its own, which only its data show.
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
    the first step of an episode. None for a task whose observations do not give its state.

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
