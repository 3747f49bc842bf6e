"""Maps of SMAX, JaxMARL's skirmish, against its own heuristic enemy: "smax/5m_vs_6m".

SMAX has other rules than SMAC, and other observations, actions, limit and reward: what it gives
is passed on, with the mask of the available actions after the observation. JaxMARL is an extra
(about 1 GB); it and JAX are imported when an environment is asked for, which takes seconds, and
its first reset and step compile for as long again.

An episode's randomness is keyed by its seed and the step, so a state can be gone back to.
"""

import importlib
from collections.abc import Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.envs.base import Outcome, at_least_one
from otc_dist.envs.discrete_actions import chosen
from otc_dist.envs.family import Family, RandomData
from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError, unknown
from otc_dist.transitions import Bool, Float32, Float64

PREFIX = "smax/"


def knows(env_id: str) -> bool:
    """Whether the id names a map; which maps there are is SMAX's to say."""
    return env_id.startswith(PREFIX)


def versions() -> dict[str, str]:
    """Of what decides how battles go. Raises UserError if SMAX is not installed."""
    try:
        return {package: version(package) for package in ("jaxmarl", "jax")}
    except PackageNotFoundError as error:
        raise _missing("SMAX", error.name) from None


def _missing(what: str, package: str | None) -> UserError:
    return UserError(f"{what} needs JaxMARL, and {package} is missing: {install('smax')}")


@cache
def _game(env_id: str) -> Any:
    """The map's functions. Raises UserError if SMAX is not installed or has no such map."""
    try:
        smax = importlib.import_module("jaxmarl.environments.smax")
        maps = importlib.import_module("jaxmarl.environments.smax.smax_env")
    except ModuleNotFoundError as error:
        raise _missing(env_id, error.name) from None
    name = env_id.removeprefix(PREFIX)
    if name not in maps.MAP_NAME_TO_SCENARIO:
        raise unknown("SMAX map", name, maps.MAP_NAME_TO_SCENARIO)
    return smax.HeuristicEnemySMAX(scenario=maps.map_name_to_scenario(name))


@cache
def team_spec(env_id: str) -> TeamSpec:
    """The team of a map. Raises UserError if SMAX is not installed or has no such map."""
    game = _game(env_id)
    agents = []
    for index, name in enumerate(game.agents):
        (size,), choices = game.observation_spaces[name].shape, int(game.action_spaces[name].n)
        bounds = (0.0,), (choices - 1.0,)
        agents.append(AgentSpec(f"agent_{index}", size + choices, *bounds, choices=choices))
    _, leaves = _template(env_id)
    return TeamSpec(
        env_id=env_id,
        agents=tuple(agents),
        state_size=2 + sum(int(np.prod(leaf.shape)) for leaf in leaves),
        max_episode_steps=int(game.max_steps),
    )


def _template(env_id: str) -> tuple[Any, list[Any]]:
    """How one copy's state is made up: the tree, and shape and type of its leaves."""
    jax = importlib.import_module("jax")
    key = jax.ShapeDtypeStruct((2,), np.uint32)
    _, state = jax.eval_shape(_game(env_id).reset, key)
    leaves, tree = jax.tree.flatten(state)
    return tree, leaves


class SmaxEnv:
    """E battles of SMAX, a `BatchedEnv` with discrete actions. See the module.

    Raises:
        UserError: SMAX is not installed or has no such map.
        ValueError: fewer than one copy.
    """

    def __init__(self, env_id: str, copies: int) -> None:
        self.spec = team_spec(env_id)
        self.copies = at_least_one(copies)
        self._jax = jax = importlib.import_module("jax")
        game = _game(env_id)

        def start(key: Any) -> Any:
            return game.reset(key)[1]

        def step(key: Any, state: Any, actions: Any) -> Any:
            key = jax.random.fold_in(key, state.state.step)
            orders = dict(zip(game.agents, actions, strict=True))
            _, state, rewards, *_ = game.step_env(key, state, orders)
            return state, [rewards[name] for name in game.agents]

        def see(state: Any) -> Any:
            seen, masks = game.get_obs(state), game.get_avail_actions(state)
            return [(seen[name], masks[name]) for name in game.agents]

        self._start = jax.jit(start)
        self._advance, self._look = jax.jit(jax.vmap(step)), jax.jit(jax.vmap(see))
        self._tree, leaves = _template(env_id)
        # The copies' seeds as keys, and their states: arrays (E, ...).
        self._keys = np.zeros((copies, 2), np.uint32)
        self._leaves = [np.zeros((copies, *leaf.shape), leaf.dtype) for leaf in leaves]
        self._won = np.zeros(copies, np.bool_)
        self._seen: tuple[Float32, ...] = ()

    @property
    def success(self) -> Bool:
        """Which battles the last step won, (E,)."""
        return self._won

    def _states(self) -> Any:
        return self._jax.tree.unflatten(self._tree, self._leaves)

    def _sides(self) -> tuple[Bool, Bool]:
        """In which copies somebody lives: of the agents, of the enemies."""
        alive = np.asarray(self._states().state.unit_alive)
        count = len(self.spec.agents)
        ours: Bool = np.logical_or.reduce(alive[:, :count], axis=1)
        theirs: Bool = np.logical_or.reduce(alive[:, count:], axis=1)
        return ours, theirs

    def _see(self) -> None:
        self._seen = tuple(
            np.concatenate([seen, mask], axis=1, dtype=np.float32)
            for seen, mask in self._look(self._states())
        )

    def reset(self, which: NDArray[np.int64], seeds: NDArray[np.int64]) -> None:
        """See `BatchedEnv.reset`."""
        for copy, seed in zip(which.tolist(), seeds.tolist(), strict=True):
            self._keys[copy] = seed >> 32, seed & 0xFFFFFFFF
            state = self._jax.tree.leaves(self._start(self._keys[copy]))
            for leaf, value in zip(self._leaves, state, strict=True):
                leaf[copy] = value
        self._see()

    def observe(self) -> tuple[Float32, ...]:
        """See `BatchedEnv.observe`."""
        return tuple(seen.copy() for seen in self._seen)

    def step(self, actions: Sequence[Float32]) -> Outcome:
        """See `BatchedEnv.step`. Raises ValueError for an action that is not available, too."""
        choices = self.spec.agents[0].choices
        masks = np.stack([seen[:, -choices:] > 0 for seen in self._seen], axis=1)
        orders = chosen(self.spec, actions, masks).astype(np.int32)
        states, rewards = self._advance(self._keys, self._states(), orders)
        self._leaves = [np.array(leaf) for leaf in self._jax.tree.leaves(states)]
        self._see()
        ours, theirs = self._sides()
        self._won, terminated = ours & ~theirs, ~(ours & theirs)
        elapsed = np.asarray(self._states().state.step)
        truncated = (elapsed >= self.spec.max_episode_steps) & ~terminated
        return Outcome(tuple(np.array(x, np.float32) for x in rewards), terminated, truncated)

    def state(self) -> Float64:
        """See `BatchedEnv.state`: the episode's key, then all that makes up SMAX's state."""
        parts = [self._keys, *self._leaves]
        return np.concatenate(
            [part.reshape(self.copies, -1) for part in parts], 1, dtype=np.float64
        )

    def set_state(self, state: Float64) -> None:
        """See `BatchedEnv.set_state`. Raises ValueError for another shape."""
        if state.shape != (self.copies, self.spec.state_size):
            raise ValueError(
                f"the state has shape {state.shape}, not {(self.copies, self.spec.state_size)}"
            )
        self._keys = state[:, :2].astype(np.uint32)
        at = 2
        for index, leaf in enumerate(self._leaves):
            size = leaf[0].size
            part = state[:, at : at + size].reshape(leaf.shape)
            self._leaves[index], at = part.astype(leaf.dtype), at + size
        self._see()

    def close(self) -> None:
        """Nothing to release."""


FAMILY = Family(
    knows,
    team_spec,
    lambda env_id, copies, progress: SmaxEnv(env_id, copies),
    random_data=RandomData(234_224, lambda env_id: versions(), policy="random"),
)
