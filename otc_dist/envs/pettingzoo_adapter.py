"""A PettingZoo environment of the user's own: "my_module:parallel_env".

The id names a function, in a module that Python can import, that returns a `ParallelEnv`. Each copy
is an environment of its own, one after the other in this process. What is asked of it:

- All agents are there from the start of an episode to its end.
- Observations and actions are `Box` or `Discrete`; `Box` actions are bounded. A discrete action's
  mask, if there is one, is in `infos[agent]["action_mask"]`, as PettingZoo's own have it.
- `reset(seed=...)` determines the episode, or runs are not repeatable.

It cannot be set to a state, so `state` is what the agents observe: a deployment that was cut off is
continued by playing its episodes again, and that shows whether they came out the same.
"""

import hashlib
import importlib
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, flatdim
from numpy.typing import NDArray

from otc_dist.envs import pettingzoo_checks as checks
from otc_dist.envs.base import Outcome, at_least_one
from otc_dist.errors import UserError
from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.transitions import Float32, Float64, all_finite

MAX_STEPS = 1000  # where the environment has no `max_cycles`

_ID = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*", re.ASCII)
_NAME = re.compile(r"[\w-]+", re.ASCII)  # it becomes part of bus keys and file names


def knows(env_id: str) -> bool:
    """Whether the id has the form module:function; whether they exist shows when it is made."""
    return _ID.fullmatch(env_id) is not None


@cache
def team_spec(env_id: str) -> TeamSpec:
    """The team, from an environment that is made and closed again.

    Raises:
        UserError: no such module or function, or an environment that cannot be used here.
    """
    env = _made(env_id)
    try:
        with checks.in_users_code(env_id, "asked for its agents and their spaces, it"):
            names = tuple(str(name) for name in env.possible_agents)
            agents = tuple(_agent(env_id, env, name) for name in names)
        limit = int(getattr(env.unwrapped, "max_cycles", MAX_STEPS))
    finally:
        env.close()
    if not agents:
        raise UserError(f"{env_id} has no agents")
    return TeamSpec(env_id, agents, sum(agent.observation_size for agent in agents), limit)


@cache
def versions(env_id: str) -> dict[str, str]:
    """Of PettingZoo and of what makes the environment: its package, and the user's module.

    Raises:
        UserError: as `team_spec`.
    """
    env = _made(env_id)
    package = type(env.unwrapped).__module__.partition(".")[0]
    env.close()
    found = {}
    for name in ("pettingzoo", package):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # the user's own module
            continue
    module = importlib.import_module(env_id.partition(":")[0])
    source = Path(str(module.__file__)).read_bytes()
    return {**found, f"{module.__name__} sha256": hashlib.sha256(source).hexdigest()}


def _made(env_id: str) -> Any:  # PettingZoo is untyped
    module_name, _, function = env_id.partition(":")
    try:
        made = getattr(importlib.import_module(module_name), function)()
    except ModuleNotFoundError as error:
        raise UserError(
            f"{env_id}: there is no module {error.name}; start from the folder that holds it, or"
            " install it"
        ) from None
    except Exception as error:  # whatever the user's code raises
        raise UserError(f"{env_id} cannot be made: {checks.described(error)}") from error
    if not hasattr(made, "possible_agents") or hasattr(made, "agent_iter"):
        raise UserError(
            f"{env_id} gave {type(made).__name__}, which is no ParallelEnv of PettingZoo with"
            " `possible_agents`"
        )
    return made


def _agent(env_id: str, env: Any, name: str) -> AgentSpec:
    if not _NAME.fullmatch(name):
        raise UserError(f"{env_id}: an agent is called {name!r}; use letters, digits, _ and -")
    seen, done = env.observation_space(name), env.action_space(name)
    for what, space in (("observes", seen), ("acts in", done)):
        if not isinstance(space, Box | Discrete):
            raise UserError(f"{env_id}: {name} {what} {space}; only Box and Discrete can be used")
    size = flatdim(seen)
    if isinstance(done, Discrete):
        choices = int(done.n)
        return AgentSpec(name, size + choices, (0.0,), (choices - 1.0,), choices=choices)
    if not done.is_bounded():
        raise UserError(f"{env_id}: {name} acts in {done}; actions must be bounded")
    low, high = (tuple(map(float, np.ravel(bound))) for bound in (done.low, done.high))
    return AgentSpec(name, size, low, high)


class PettingZooEnv:
    """E copies of the user's environment, a `BatchedEnv`. See the module.

    Raises:
        UserError: as `team_spec`; when played, what the user's code raises, an agent that leaves
            before the others, a number that is not finite, or what does not fit the spaces.
        ValueError: fewer than one copy.
    """

    def __init__(self, env_id: str, copies: int) -> None:
        self.spec = team_spec(env_id)
        self.copies = at_least_one(copies)
        self._envs = [_made(env_id) for _ in range(copies)]
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
            seen, infos = checks.returned(self.spec.env_id, "reset", given)
            self._elapsed[copy] = 0
            self._see(copy, seen, infos, last=False)

    def _see(
        self, copy: int, seen: Mapping[str, Any], infos: Mapping[str, Any], last: bool
    ) -> None:
        env, env_id = self._envs[copy], self.spec.env_id
        for agent, rows in zip(self.spec.agents, self._seen, strict=True):
            if agent.name not in seen:
                raise self._gone(agent.name)
            size, space = agent.observation_size - agent.choices, env.observation_space(agent.name)
            rows[copy, :size] = checks.observation(env_id, agent.name, space, seen[agent.name])
            if agent.choices:
                info = infos.get(agent.name)
                rows[copy, size:] = checks.mask(env_id, agent.name, info, agent.choices, last)
            if not all_finite(rows[copy]):
                raise UserError(f"{env_id}: {agent.name} observes NaN or infinity")

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
        orders = [self._orders(index, actions[index]) for index in range(len(self.spec.agents))]
        rewards = np.zeros((len(orders), self.copies), np.float32)
        terminated, truncated = np.zeros((2, self.copies), np.bool_)
        for copy, env in enumerate(self._envs):
            wanted = {
                name: order[copy] for name, order in zip(self.spec.names, orders, strict=True)
            }
            with checks.in_users_code(self.spec.env_id, "step"):
                given = env.step(wanted)
            seen, earned, over, cut, infos = checks.returned(self.spec.env_id, "step", given)
            self._elapsed[copy] += 1
            rewards[:, copy] = [
                checks.reward(self.spec.env_id, name, earned.get(name, 0.0))
                for name in self.spec.names
            ]
            terminated[copy] = self._all(over)
            truncated[copy] = not terminated[copy] and (
                self._elapsed[copy] >= self.spec.max_episode_steps
                or self._all({name: over[name] or cut.get(name, False) for name in over})
            )
            self._see(copy, seen, infos, last=bool(terminated[copy]))
        if not all_finite(rewards):
            raise UserError(f"{self.spec.env_id} gave a reward that is NaN or infinite")
        return Outcome(tuple(rewards), terminated, truncated)

    def _orders(self, index: int, action: Float32) -> Sequence[Any]:
        """One agent's actions as its environments take them, checked and clipped."""
        agent, space = self.spec.agents[index], self._envs[0].action_space(self.spec.names[index])
        if action.shape != (self.copies, agent.action_size) or not all_finite(action):
            raise ValueError(
                f"the action of {agent.name} is not finite or has shape {action.shape}, not "
                f"{(self.copies, agent.action_size)}"
            )
        if isinstance(space, Box):
            clipped = np.clip(action, agent.action_low, agent.action_high).astype(space.dtype)
            return list(clipped.reshape(self.copies, *space.shape))
        indices = action[:, 0].astype(np.int64)
        mask = self._seen[index][:, -agent.choices :] > 0
        right = (indices == action[:, 0]) & (indices >= 0) & (indices < agent.choices)
        right &= np.take_along_axis(mask, indices[:, None] % agent.choices, axis=1)[:, 0]
        if not right.all():
            copy = int(np.flatnonzero(~right)[0])
            raise ValueError(f"{agent.name} cannot take action {action[copy, 0]:g} in copy {copy}")
        return [int(space.start) + choice for choice in indices.tolist()]

    def _all(self, ended: Mapping[str, bool]) -> bool:
        """Whether the episode is over for all. Raises UserError if it is for some only."""
        flags = [bool(ended.get(name, True)) for name in self.spec.names]
        if any(flags) and not all(flags):
            raise self._gone(self.spec.names[flags.index(True)])
        return all(flags)

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
            env.close()
