"""The skirmish as an environment: a native stand-in for SMAC's `5m_vs_6m` that is not StarCraft.

`skirmish_rules` says what it shares with SMAC and what it simplifies. Shapes and meaning are
those of SMAC's defaults: an agent observes 4 + 6 x 5 + 4 x 5 + 1 = 55 numbers,

- whether it may move north, south, east, west;
- of each enemy: whether it may be attacked, distance, x and y from here (all over the sight of
  9 cells), health (over 45);
- of each fellow agent: whether it is seen, distance, x and y, health;
- its own health;

all zero of units that are dead or out of sight, and of a dead agent altogether. Then comes the
mask of its 12 available actions: no-op (the only one of the dead), stop, north, south, east,
west, attack enemy 0 to 5. Weapons' cooldowns are not observed.

All agents, the dead among them, get the same reward: points of damage dealt to enemies, 10 a
kill and 200 for the win, scaled such that the return of a won battle is 20.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otc_dist.envs.base import Outcome, at_least_one
from otc_dist.envs.discrete_actions import chosen
from otc_dist.envs.family import Family
from otc_dist.envs.skirmish_rules import (
    EAST,
    FIRST_ATTACK,
    HEALTH,
    KILL_REWARD,
    NORTH,
    SIGHT,
    SOUTH,
    WEST,
    WIN_REWARD,
    Battle,
    Skirmish,
)
from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.transitions import Bool, Float32, Float64

SKIRMISHES = {"5m_vs_6m": Skirmish(agents=5, enemies=6, limit=70)}

_MOVES = [NORTH, SOUTH, EAST, WEST]
_FEATURES = 5  # of each other unit


def team_spec(env_id: str) -> TeamSpec:
    """The team of a skirmish. Raises KeyError for an unknown id."""
    rules = SKIRMISHES[env_id]
    seen = len(_MOVES) + _FEATURES * (rules.units - 1) + 1
    return TeamSpec(
        env_id=env_id,
        agents=tuple(
            AgentSpec(
                f"agent_{i}",
                seen + rules.choices,
                (0.0,),
                (rules.choices - 1.0,),
                choices=rules.choices,
            )
            for i in range(rules.agents)
        ),
        state_size=1 + 4 * rules.units,
        max_episode_steps=rules.limit,
    )


class SkirmishEnv:
    """E battles, a `BatchedEnv` with discrete actions.

    An episode terminates when one side is dead; the other has won. At the limit of 70 steps it
    is truncated.

    Raises:
        KeyError: unknown `env_id`.
        ValueError: fewer than one copy.
    """

    def __init__(self, env_id: str, copies: int) -> None:
        self.spec = team_spec(env_id)
        self.copies = at_least_one(copies)
        self._rules = rules = SKIRMISHES[env_id]
        self._battle = Battle(rules, copies)
        self._elapsed = np.zeros(copies, np.int64)
        self._won = np.zeros(copies, np.bool_)
        agents = np.arange(rules.agents)
        # Whom agent i sees as its j-th fellow: (N, N - 1).
        self._fellows = np.array([np.delete(agents, i) for i in agents])
        self._see()

    @property
    def success(self) -> Bool:
        """Which battles the last step won, (E,)."""
        return self._won

    def reset(self, which: NDArray[np.int64], seeds: NDArray[np.int64]) -> None:
        """See `BatchedEnv.reset`; a seed says where within 1/8 of a cell each unit starts."""
        for copy, seed in zip(which.tolist(), seeds.tolist(), strict=True):
            self._battle.start(copy, np.random.default_rng(seed))
        self._elapsed[which] = 0
        self._see()

    def _see(self) -> None:
        """Work out once what both observations and the check of actions need."""
        self._offsets = self._battle.offsets()
        self._available = self._battle.available(self._offsets[2])

    def observe(self) -> tuple[Float32, ...]:
        """See `BatchedEnv.observe`."""
        count, battle, available = self._rules.agents, self._battle, self._available
        dx, dy, squares = self._offsets
        alive = battle.alive
        flags = np.ones(squares.shape)
        flags[:, :, count:] = available[:, :, FIRST_ATTACK:]
        health = np.broadcast_to(battle.health[:, None, :] / HEALTH, squares.shape)
        of_units = (flags, np.sqrt(squares) / SIGHT, dx / SIGHT, dy / SIGHT, health)
        visible = (squares < SIGHT**2) & alive[:, None, :] & alive[:, :count, None]
        # (E, N, units, features)
        units = np.stack(of_units, axis=3) * visible[..., None]
        agents = np.arange(count)[:, None]
        rows = np.concatenate(
            (
                available[:, :, _MOVES],
                units[:, :, count:].reshape(self.copies, count, -1),
                units[:, agents, self._fellows].reshape(self.copies, count, -1),
                health[:, 0, :count, None],
                available,
            ),
            axis=2,
            dtype=np.float32,
        )
        return tuple(np.ascontiguousarray(rows.swapaxes(0, 1)))

    def step(self, actions: Sequence[Float32]) -> Outcome:
        """See `BatchedEnv.step`. Raises ValueError for an action that is not available, too."""
        orders = chosen(self.spec, actions, self._available)
        count, battle = self._rules.agents, self._battle
        before = battle.health[:, count:]
        battle.advance(orders)
        self._elapsed += 1
        self._see()

        alive, after = battle.alive, battle.health[:, count:]
        kills = ((before > 0) & (after == 0)).sum(axis=1)
        ours: Bool = np.logical_or.reduce(alive[:, :count], axis=1)
        theirs: Bool = np.logical_or.reduce(alive[:, count:], axis=1)
        self._won = ours & ~theirs & (kills > 0)
        reward = (before - after).sum(axis=1) + KILL_REWARD * kills + WIN_REWARD * self._won
        reward = (reward * self._rules.reward_scale).astype(np.float32)
        terminated = ~(ours & theirs)
        truncated = (self._elapsed >= self._rules.limit) & ~terminated
        return Outcome((reward,) * count, terminated, truncated)

    def state(self) -> Float64:
        """See `BatchedEnv.state`: elapsed steps, then x, y, health and cooldown of all units.

        SMAC's own state of 98 numbers shows the same but for the enemies' cooldowns and the time,
        and the agents' last actions besides, which nothing here depends on.
        """
        battle = self._battle
        elapsed = self._elapsed[:, None].astype(np.float64)
        return np.concatenate((elapsed, battle.x, battle.y, battle.health, battle.cooldown), axis=1)

    def set_state(self, state: Float64) -> None:
        """See `BatchedEnv.set_state`. Raises ValueError for another shape."""
        if state.shape != (self.copies, self.spec.state_size):
            raise ValueError(
                f"the state has shape {state.shape}, not {(self.copies, self.spec.state_size)}"
            )
        self._elapsed[...] = state[:, 0]
        battle = self._battle
        parts = np.split(state[:, 1:].copy(), 4, axis=1)
        battle.x, battle.y, battle.health, battle.cooldown = parts
        self._see()

    def close(self) -> None:
        """Nothing to release."""


FAMILY = Family(
    SKIRMISHES.__contains__,
    team_spec,
    lambda env_id, copies, progress: SkirmishEnv(env_id, copies),
    usual=tuple(SKIRMISHES),
)
