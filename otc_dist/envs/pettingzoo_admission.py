"""Admission of a PettingZoo environment: what it says of its agents, checked before it is played.

Nothing that it says is taken on trust. What can be used is brought into the form that the rest of
`otc_dist` knows, float32 vectors and bounds, and the way back is kept beside it: an agent's own key
(which may be a number), and how its action becomes what its space asks for. What cannot be used is
refused in one line. What it gives while it is played is checked by `pettingzoo_checks`.

- An action `Box` of whole numbers: the action that is sent is rounded to the nearest.
- An entry of an action `Box` with one value only is no part of the agent's action: it is filled in.
- An action that float32 cannot scale to [-1, 1] and back, because its bounds are too far apart or
  too near to each other, is refused.
"""

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray

from otc_dist.envs import pettingzoo_checks as checks
from otc_dist.names import check_agents
from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32

MAX_STEPS = 1000  # where the environment has no `max_cycles`
MOST_STEPS = 100_000  # whatever its `max_cycles` says: episodes are held in memory
MOST_NUMBERS = 1_000_000  # of one agent's observation, with the mask, or of its action

_EXACT = 2**24  # float32 holds every whole number up to here


@dataclass(frozen=True)
class Agent:
    """One agent, as the environment and as we know it."""

    key: Hashable  # what the environment calls it, in `possible_agents` and in dictionaries
    spec: AgentSpec
    seen: Box | Discrete
    done: Box | Discrete
    free: Bool  # (A,) of a `Box` action's A entries, which have more than one value

    @property
    def whole(self) -> bool:
        """Whether actions are rounded to whole numbers."""
        return isinstance(self.done, Box) and _whole(self.done)

    def orders(self, actions: Float32) -> Sequence[Any]:
        """E actions (E, action_size) as the environment takes them, of its shapes and types.

        Those of a `Box` are clipped to its bounds. Those of `Discrete` must be indices.
        """
        space = self.done
        if isinstance(space, Discrete):
            return [int(space.start) + int(choice) for choice in actions[:, 0]]
        low, high = np.array((self.spec.action_low, self.spec.action_high), np.float32)
        clipped = np.clip(actions, low, high)
        rows = np.tile(space.low.reshape(1, -1), (len(actions), 1))
        rows[:, self.free] = np.rint(clipped) if self.whole else clipped
        # Once more: a bound that is no float32 may lie beside the nearest one that is.
        np.minimum(np.maximum(rows, space.low.ravel(), out=rows), space.high.ravel(), out=rows)
        return list(rows.reshape(len(actions), *space.shape))


@dataclass(frozen=True)
class Admitted:
    """What an environment that can be used is, and what is done to its actions."""

    team: TeamSpec
    agents: tuple[Agent, ...]
    limit: int  # after how many steps it says that its episodes are cut; 0: it does not say

    @property
    def keys(self) -> frozenset[Hashable]:
        """The agents' names in the environment's own dictionaries."""
        return frozenset(agent.key for agent in self.agents)

    def remarks(self) -> Iterator[str]:
        """In words, what becomes of actions on the way to the environment."""
        if whole := [agent.spec.name for agent in self.agents if agent.whole]:
            yield f"actions of {', '.join(whole)} are rounded to whole numbers"
        for agent in self.agents:
            if fixed := int((~agent.free).sum()):
                yield (
                    f"{fixed} of {len(agent.free)} entries of the actions of {agent.spec.name}"
                    " have one value only: they are filled in"
                )


def admitted(env_id: str, env: Any) -> Admitted:  # PettingZoo is untyped
    """Look at an environment that was made.

    Raises:
        UserError: it cannot be used here, or its code raised something.
    """
    with checks.in_users_code(env_id, "asked for its agents, it"):
        keys = tuple(env.possible_agents)
    if not keys:
        raise UserError(f"{env_id} has no agents")
    try:
        check_agents(map(str, keys))
    except ValueError as error:
        raise UserError(f"{env_id}: {error}") from None
    agents = tuple(_agent(env_id, env, key) for key in keys)
    specs = tuple(agent.spec for agent in agents)
    state_size, limit = sum(spec.observation_size for spec in specs), _limit(env_id, env)
    return Admitted(TeamSpec(env_id, specs, state_size, limit or MAX_STEPS), agents, limit)


def inner(env: Any) -> Any:
    """The environment below its wrappers; itself where it does not say."""
    return getattr(env, "unwrapped", env)


def _limit(env_id: str, env: Any) -> int:
    """After how many steps it says that its episodes are cut; 0 if it says nothing."""
    with checks.in_users_code(env_id, "asked for its max_cycles, it"):
        given = getattr(inner(env), "max_cycles", None)
    if given is None:
        return 0
    number = checks.number(given)
    if number == math.inf:  # another way to say that there is none
        return 0
    if number is None or not number >= 1 or number != int(number):
        raise UserError(
            f"{env_id}: max_cycles is {checks.shown(given)}; it must be a whole number from 1 on,"
            " or None"
        )
    return int(min(number, MOST_STEPS))


def _agent(env_id: str, env: Any, key: Hashable) -> Agent:
    name = str(key)
    with checks.in_users_code(env_id, f"asked for the spaces of {name}, it"):
        seen, done = env.observation_space(key), env.action_space(key)
    for what, space in (("observes", seen), ("acts in", done)):
        if not isinstance(space, Box | Discrete):
            raise UserError(
                f"{env_id}: {name} {what} {checks.shown(space)}; only Box and Discrete can be used"
            )
    choices = int(done.n) if isinstance(done, Discrete) else 0
    size, entries = _size(seen), 1 if choices else _size(done)
    for what, count in (("observes", size + choices), ("sends", entries)):
        if not 0 < count <= MOST_NUMBERS:
            raise UserError(
                f"{env_id}: {name} {what} {count:,} numbers; from 1 to {MOST_NUMBERS:,} can be used"
            )
    if choices:
        spec = AgentSpec(name, size + choices, (0.0,), (choices - 1.0,), choices=choices)
        return Agent(key, spec, seen, done, np.ones(1, np.bool_))
    free = _free_entries(f"{env_id}: {name} acts in {checks.shown(done)}", done)
    low, high = (tuple(map(float, np.ravel(bound)[free])) for bound in (done.low, done.high))
    return Agent(key, AgentSpec(name, size, low, high), seen, done, free)


def _size(space: Box | Discrete) -> int:
    return int(space.n) if isinstance(space, Discrete) else math.prod(space.shape)


def _whole(space: Box) -> bool:
    return np.dtype(space.dtype).kind in "biu"


def _free_entries(where: str, space: Box) -> Bool:
    """Which entries of an action have more than one value, (A,), all of them checked."""
    low, high = (np.ravel(bound).astype(np.float64) for bound in (space.low, space.high))
    if not space.is_bounded() or not np.isfinite((low, high)).all():
        raise UserError(f"{where}; actions must be bounded")
    if (low > high).any():
        raise UserError(f"{where}; a lower bound is above its upper one")
    if _whole(space) and max(np.abs(low).max(), np.abs(high).max()) > _EXACT:
        raise UserError(f"{where}; float32 cannot distinguish whole numbers beyond {_EXACT:,}")
    free: NDArray[np.bool_] = low < high
    if not free.any():
        raise UserError(f"{where}, in which there is nothing to choose")
    with np.errstate(over="ignore", invalid="ignore"):
        bounds = np.stack((low, high)).astype(np.float32)[:, free]
        scale, centre = (bounds[1] - bounds[0]) / 2, bounds.sum(axis=0)
    if not (np.isfinite(scale) & np.isfinite(centre) & (scale > 0)).all():
        raise UserError(
            f"{where}; float32 cannot scale that to [-1, 1] and back: choose other bounds"
        )
    return free
