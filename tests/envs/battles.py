"""Battles of the skirmish that stand as a test tells, and what is seen of them."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from otc_dist.envs import registry
from otc_dist.envs.base import BatchedEnv, Outcome
from otc_dist.envs.skirmish_rules import GRID
from otc_dist.transitions import Float32, Float64

AGENTS, ENEMIES, UNITS = 5, 6, 11
NO_OP, STOP, NORTH, SOUTH, EAST, WEST = range(6)
HOME = [(9.0, 12.0 + 2 * i) for i in range(AGENTS)]
CAMP = [(26.0, 11.0 + 2 * i) for i in range(ENEMIES)]


def attack(enemy: int) -> int:
    return 6 + enemy


def battle(
    agents: Sequence[tuple[float, float]] = HOME,
    enemies: Sequence[tuple[float, float]] = CAMP,
    health: Mapping[int, float] = MappingProxyType({}),
    cooldown: Mapping[int, float] = MappingProxyType({}),
    elapsed: int = 0,
    copies: int = 1,
) -> BatchedEnv:
    """Battles that stand as told, in cells; `health` and `cooldown` are of single units."""
    env = registry.make("5m_vs_6m", copies)
    places = np.array([*agents, *enemies]) * GRID
    points, waiting = np.full(UNITS, 45.0), np.zeros(UNITS)
    for unit, value in health.items():
        points[unit] = value
    for unit, value in cooldown.items():
        waiting[unit] = value
    state = np.concatenate([[elapsed], places[:, 0], places[:, 1], points, waiting])
    env.set_state(np.tile(state, (copies, 1)))
    return env


def play(env: BatchedEnv, *orders: int) -> Outcome:
    """One step of copy 0 .. with the same orders in every copy; agents without one stop."""
    mask = masks_of(env)
    chosen = [*orders, *[STOP] * (AGENTS - len(orders))]
    actions = [
        np.where(mask[i][:, NO_OP] > 0, NO_OP, chosen[i]).astype(np.float32)[:, None]
        for i in range(AGENTS)
    ]
    return env.step(actions)


def masks_of(env: BatchedEnv) -> list[Float32]:
    return [observation[:, -12:] for observation in env.observe()]


def health_of(env: BatchedEnv) -> Float64:
    return env.state()[0, 1 + 2 * UNITS : 1 + 3 * UNITS]


def places_of(env: BatchedEnv) -> Float64:
    return env.state()[0, 1 : 1 + 2 * UNITS].reshape(2, UNITS).T / GRID


def random_actions(env: BatchedEnv, random: np.random.Generator) -> list[Float32]:
    actions = []
    for mask in masks_of(env):
        keys = random.random(mask.shape) * (mask > 0)
        actions.append(keys.argmax(axis=1).astype(np.float32)[:, None])
    return actions
