"""What a family of environments says of itself, in its own file; `registry` has a line for each."""

from collections.abc import Callable
from dataclasses import dataclass

from otc_dist.envs.base import BatchedEnv
from otc_dist.spec import Task, TeamSpec
from otc_dist.transitions import Float32, Float64

FOREIGN_TRANSITIONS = 100_000  # of random data of somebody else's environments, which may be slow


@dataclass(frozen=True)
class RandomData:
    """Data of uniformly random policies, for a family of which nothing else is made."""

    transitions: int  # where nobody asks for another number
    # What determines the data of an environment besides their seed and our own version.
    recipe: Callable[[str], dict[str, str]] = lambda env_id: {}
    policy: str = "uniform"  # its name, on which the episodes' seeds depend


@dataclass(frozen=True)
class Family:
    """Environments that share an implementation; its simulator is imported only by `make`."""

    knows: Callable[[str], bool]  # whether an id names one of them
    team_spec: Callable[[str], TeamSpec]
    make: Callable[[str, int, float | None], BatchedEnv]  # see `registry.make`
    usual: tuple[str, ...] = ()  # ids to list; there may be more
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
    random_data: RandomData | None = None  # None: a source in `otc_dist.datasets` makes its data
