"""A PettingZoo environment of the user's own: "my_module:parallel_env".

The id names a function, in a module that Python can import, that returns a `ParallelEnv`. Each copy
is an environment of its own, one after the other in this process. What is asked of it:

- All agents are there from the start of an episode to its end.
- Observations and actions are `Box` or `Discrete`; `Box` actions are bounded. A discrete action's
  mask, if there is one, is in `infos[agent]["action_mask"]`, as PettingZoo's own have it. See
  `pettingzoo_admission`, which looks at what it says of itself.
- `reset(seed=...)` determines the episode, or runs are not repeatable.

It cannot be set to a state, so `state` is what the agents observe: a deployment that was cut off is
continued by playing its episodes again, and that shows whether they came out the same.
"""

import sys
from collections.abc import Hashable, Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.description import user_code
from otc_dist.envs import own_sources
from otc_dist.envs import pettingzoo_checks as checks
from otc_dist.envs.base import Outcome, at_least_one
from otc_dist.envs.family import FOREIGN_TRANSITIONS, Family, RandomData
from otc_dist.envs.pettingzoo_admission import Admitted, admitted, inner
from otc_dist.names import is_code
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32, Float64, all_finite


def knows(env_id: str) -> bool:
    """Whether the id has the form module:function; whether they exist shows when it is made."""
    return is_code(env_id)


@cache
def _admitted(env_id: str) -> Admitted:
    """Of an environment that is made and closed again. Raises UserError as `team_spec`."""
    env = _made(env_id)
    try:
        return admitted(env_id, env)
    finally:
        _close(env_id, env)


def team_spec(env_id: str) -> TeamSpec:
    """The team, from an environment that is made and closed again.

    Raises:
        UserError: no such module or function, or an environment that cannot be used here.
    """
    return _admitted(env_id).team


def time_limit(env_id: str) -> int:
    """Its `max_cycles`; 0 where it has none. Raises UserError as `team_spec`."""
    return _admitted(env_id).limit


def remarks(env_id: str) -> tuple[str, ...]:
    """In words, what becomes of actions on their way to it. Raises UserError as `team_spec`."""
    return tuple(_admitted(env_id).remarks())


@cache
def versions(env_id: str) -> dict[str, str]:
    """Of PettingZoo and of what makes the environment: its package, and the user's sources.

    Raises:
        UserError: as `team_spec`.
    """
    env = _made(env_id)
    package = type(inner(env)).__module__.partition(".")[0]
    _close(env_id, env)
    found = {}
    for name in ("pettingzoo", package):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # the user's own module
            continue
    named = env_id.partition(":")[0]
    files = {f"{named.replace('.', '/')}{end}" for end in (".py", "/__init__.py")}
    for path, digest in sources(env_id).items():
        found[f"{named if path in files else path} sha256"] = digest
    return found


@cache
def sources(env_id: str) -> dict[str, str]:
    """Path -> SHA-256 of the user's own sources of an environment; see `own_sources`.

    Raises:
        UserError: as `team_spec`.
    """
    team_spec(env_id)  # which makes it
    return own_sources.digests(env_id.partition(":")[0], _brought[env_id])


# Environment -> the modules that were loaded when it was first made in this process.
_brought: dict[str, frozenset[str]] = {}


def _made(env_id: str) -> Any:  # PettingZoo is untyped
    before = frozenset(sys.modules)
    try:
        made: Any = user_code.found(env_id)()
    except UserError:
        raise
    except (Exception, SystemExit) as error:  # whatever the user's code raises
        raise UserError(f"{env_id} cannot be made: {user_code.described(error)}") from error
    with checks.in_users_code(env_id, "asked for its possible_agents, it"):
        turns, agents = hasattr(made, "agent_iter"), hasattr(made, "possible_agents")
    if turns:
        raise UserError(
            f"{env_id} gave {type(made).__name__}, whose agents act in turn: return"
            " pettingzoo.utils.aec_to_parallel(env) instead"
        )
    if not agents:
        raise UserError(
            f"{env_id} gave {type(made).__name__}, which is not a PettingZoo ParallelEnv with"
            " `possible_agents`"
        )
    _brought.setdefault(env_id, frozenset(sys.modules) - before)
    return made


def _close(env_id: str, env: Any) -> None:
    if hasattr(env, "close"):
        with checks.in_users_code(env_id, "close"):
            env.close()


class PettingZooEnv:
    """E copies of the user's environment, a `BatchedEnv`. See the module.

    Raises:
        UserError: as `team_spec`; when played, what the user's code raises, an agent that leaves
            before the others, a number that is not finite, or what does not fit the spaces.
        ValueError: fewer than one copy.
    """

    def __init__(self, env_id: str, copies: int) -> None:
        self._admitted = _admitted(env_id)
        self.spec = self._admitted.team
        self.copies = at_least_one(copies)
        self._envs = [_made(env_id) for _ in range(copies)]
        if any(admitted(env_id, env).team != self.spec for env in self._envs):
            raise UserError(f"{env_id} has other agents or spaces each time that it is made")
        self._elapsed = np.zeros(copies, np.int64)
        self._seen = tuple(
            np.zeros((copies, agent.observation_size), np.float32) for agent in self.spec.agents
        )

    @property
    def versions(self) -> Mapping[str, str]:
        """See the module's `versions`."""
        return versions(self.spec.env_id)

    def reset(self, which: NDArray[np.int64], seeds: NDArray[np.int64]) -> None:
        """See `BatchedEnv.reset`."""
        for copy, seed in zip(which.tolist(), seeds.tolist(), strict=True):
            # Many environments pass it to numpy.random.seed, which takes 32 bits.
            with checks.in_users_code(self.spec.env_id, "reset"):
                given = self._envs[copy].reset(seed=seed % 2**32)
            seen, infos = checks.returned(self.spec.env_id, "reset", given, self._admitted.keys)
            self._elapsed[copy] = 0
            self._see(copy, seen, infos, last=False)

    def _see(
        self, copy: int, seen: Mapping[Hashable, Any], infos: Mapping[Hashable, Any], last: bool
    ) -> None:
        env_id = self.spec.env_id
        for agent, rows in zip(self._admitted.agents, self._seen, strict=True):
            name, choices = agent.spec.name, agent.spec.choices
            if agent.key not in seen:
                raise self._gone(name)
            size = agent.spec.observation_size - choices
            rows[copy, :size] = checks.observation(env_id, name, agent.seen, seen[agent.key])
            if choices:
                rows[copy, size:] = checks.mask(env_id, name, infos.get(agent.key), choices, last)

    def _gone(self, name: str) -> UserError:
        return UserError(
            f"{self.spec.env_id}: {name} is gone before the episode's end; only environments whose"
            " agents all stay can be used"
        )

    def observe(self) -> tuple[Float32, ...]:
        """See `BatchedEnv.observe`."""
        return tuple(rows.copy() for rows in self._seen)

    def step(self, actions: Sequence[Float32]) -> Outcome:
        """See `BatchedEnv.step`. Raises ValueError for an action that is not available, too."""
        env_id, agents = self.spec.env_id, self._admitted.agents
        orders = [self._orders(index, actions[index]) for index in range(len(agents))]
        rewards = np.zeros((len(orders), self.copies), np.float32)
        terminated, truncated = np.zeros((2, self.copies), np.bool_)
        for copy, env in enumerate(self._envs):
            wanted = {agent.key: order[copy] for agent, order in zip(agents, orders, strict=True)}
            with checks.in_users_code(env_id, "step"):
                given = env.step(wanted)
            seen, earned, over, cut, infos = checks.returned(
                env_id, "step", given, self._admitted.keys
            )
            self._elapsed[copy] += 1
            rewards[:, copy] = [
                checks.reward(env_id, agent.spec.name, earned.get(agent.key, 0.0))
                for agent in agents
            ]
            terminated[copy], truncated[copy] = self._ends(over, cut, int(self._elapsed[copy]))
            self._see(copy, seen, infos, last=bool(terminated[copy]))
        return Outcome(tuple(rewards), terminated, truncated)

    def _orders(self, index: int, action: Float32) -> Sequence[Any]:
        """One agent's actions as its environments take them, checked and clipped."""
        agent = self.spec.agents[index]
        if action.shape != (self.copies, agent.action_size) or not all_finite(action):
            raise ValueError(
                f"the action of {agent.name} is not finite or has shape {action.shape}, not "
                f"{(self.copies, agent.action_size)}"
            )
        if agent.choices:
            indices = action[:, 0].astype(np.int64)
            mask = self._seen[index][:, -agent.choices :] > 0
            right = (indices == action[:, 0]) & (indices >= 0) & (indices < agent.choices)
            right &= np.take_along_axis(mask, indices[:, None] % agent.choices, axis=1)[:, 0]
            if not right.all():
                copy = int(np.flatnonzero(~right)[0])
                raise ValueError(
                    f"{agent.name} cannot take action {action[copy, 0]:g} in copy {copy}"
                )
        return self._admitted.agents[index].orders(action)

    def _ends(
        self, over: Mapping[Hashable, object], cut: Mapping[Hashable, object], elapsed: int
    ) -> tuple[bool, bool]:
        """Whether the episode terminated, or else was truncated, for all agents.

        Of an agent that a dictionary does not name, it did not. Where some terminate in the step
        in which the others run out of time, the time limit ended the team's episode.

        Raises:
            UserError: it is over for some only.
        """
        env_id, agents = self.spec.env_id, self._admitted.agents
        terminated, truncated = (
            [checks.ended(env_id, a.spec.name, what, by.get(a.key, False)) for a in agents]
            for what, by in (("terminations", over), ("truncations", cut))
        )
        if all(terminated):
            return True, False
        if elapsed >= self.spec.max_episode_steps:
            return False, True
        ended = [t or c for t, c in zip(terminated, truncated, strict=True)]
        if any(ended) and not all(ended):
            raise self._gone(self.spec.names[ended.index(True)])
        return False, all(ended)

    def state(self) -> Float64:
        """What the agents observe, (E, state_size): to compare, not to go back to."""
        return np.concatenate(self._seen, axis=1, dtype=np.float64)

    def set_state(self, state: Float64) -> None:
        """Refused. Raises UserError: PettingZoo has no such thing."""
        del state
        raise UserError(f"{self.spec.env_id} cannot be set to a state: PettingZoo has no such call")

    def close(self) -> None:
        """Close the copies."""
        for env in self._envs:
            _close(self.spec.env_id, env)


FAMILY = Family(
    knows,
    team_spec,
    lambda env_id, copies, progress: PettingZooEnv(env_id, copies),
    time_limit=time_limit,
    remarks=remarks,
    shares_reward=False,
    sources=sources,
    random_data=RandomData(FOREIGN_TRANSITIONS, versions),
)
