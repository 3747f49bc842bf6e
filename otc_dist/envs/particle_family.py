"""The particle tasks by environment id: `predator-prey-3`, `cooperative-navigation-4` (or any other
number of agents), and `navigation`.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from otc_dist.envs import cooperative_navigation, navigation, predator_prey
from otc_dist.envs.base import BatchedEnv
from otc_dist.envs.family import Family, RandomData
from otc_dist.spec import Task, TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32, Float64

USUAL = ("predator-prey-3", "cooperative-navigation-4", navigation.ENV_ID)  # the paper's

MINIMUM_AGENTS = 2


@dataclass(frozen=True)
class _ForAnyNumber:
    """A task for any number of agents, each of its parts by that number."""

    team_spec: Callable[[int], TeamSpec]
    make: Callable[[int, int], BatchedEnv]  # agents, copies
    task: Callable[[int], Task]


_FOR_ANY_NUMBER = {
    "predator-prey": _ForAnyNumber(
        predator_prey.team_spec, predator_prey.PredatorPrey, predator_prey.PredatorPreyTask
    ),
    "cooperative-navigation": _ForAnyNumber(
        cooperative_navigation.team_spec,
        cooperative_navigation.CooperativeNavigation,
        cooperative_navigation.CooperativeNavigationTask,
    ),
}
# A log can ask for any number, and a team is made to be compared with it: up to 9,999.
_NUMBERED = re.compile(rf"({'|'.join(_FOR_ANY_NUMBER)})-(0|[1-9]\d{{0,3}})", re.ASCII)


def knows(env_id: str) -> bool:
    """Whether the id is one of a particle task, even if with too few agents."""
    return env_id == navigation.ENV_ID or _NUMBERED.fullmatch(env_id) is not None


def _numbered(env_id: str) -> tuple[_ForAnyNumber, int]:
    """The task and its number of agents. Raises UserError for too few."""
    found = _NUMBERED.fullmatch(env_id)
    if found is None:
        raise KeyError(env_id)
    name, agents = found[1], int(found[2])
    if agents < MINIMUM_AGENTS:
        raise UserError(
            f"{env_id}: {name} is for {MINIMUM_AGENTS} agents or more, not {agents};"
            f" for example {name}-3"
        )
    return _FOR_ANY_NUMBER[name], agents


def team_spec(env_id: str) -> TeamSpec:
    """The team of a particle task. Raises UserError for too few agents, KeyError if unknown."""
    if env_id == navigation.ENV_ID:
        return navigation.team_spec()
    task, agents = _numbered(env_id)
    return task.team_spec(agents)


def states_of(env_id: str, observations: Float32) -> Float64 | None:
    """Simulator states (N, state_size) in which an agent observes `observations` (N, s), at the
    first step of an episode; None for Navigation, which does not show its whole state.
    """
    if env_id == navigation.ENV_ID:
        return None
    return np.pad(observations.astype(np.float64), ((0, 0), (1, 0)))  # after the elapsed steps


def make(env_id: str, copies: int, progress: float | None) -> BatchedEnv:
    """See `registry.make`; errors as `team_spec`."""
    if env_id == navigation.ENV_ID:
        return navigation.Navigation(copies, progress)
    task, agents = _numbered(env_id)
    return task.make(agents, copies)


def changes(env_id: str) -> bool:
    """Whether the task changes in the course of the deployments."""
    return env_id == navigation.ENV_ID


def task(env_id: str) -> Task:
    """See `registry.task`; errors as `team_spec`."""
    if env_id == navigation.ENV_ID:
        return navigation.NavigationTask()
    task, agents = _numbered(env_id)
    return task.task(agents)


FAMILY = Family(
    knows,
    team_spec,
    make,
    usual=USUAL,
    task=task,
    changes=changes,
    states_of=states_of,
    random_data=RandomData(1_000_000),  # as in the paper
)
