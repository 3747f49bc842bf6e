"""The rules of the skirmish: marines against more marines, after SMAC's map `5m_vs_6m`.

This is not StarCraft. It has the shapes, the masks, the limit and the reward of SMAC (Samvelyan
et al. 2019; `oxwhirl/smac`, `starcraft2.py`), the start positions, the arena and the enemies'
standing order of its map file, and StarCraft II's numbers for a marine. Simplified are:

- Enemies attack the nearest living agent that they see, chosen anew in every game loop. The game
  weighs threats and keeps a target for a while.
- Shots hit at once and every 14 game loops. The game delays them by up to 2 loops at random; here
  chance enters by the start positions alone.
- Units that overlap are pushed apart once a step. The game steers them around each other.

Positions are whole numbers of 1/4096 of a cell, as in the game, so that sums and squares are
exact: a battle comes out the same on every machine and at any number of copies.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otc_dist.transitions import Bool, Float64

GRID = 4096.0  # positions per cell
LOOPS = 8  # game loops a step (SMAC's step_mul), 1/16 s each

HEALTH = 45.0
DAMAGE = 6.0
PERIOD = 14.0  # game loops between shots: 0.8608 s, in whole loops
SPEED = 2.25 / 16 * GRID  # a loop
RADIUS = 0.375 * GRID
REACH = 5 * GRID + 2 * RADIUS  # between centres; the weapon's range is between edges
SIGHT = 9 * GRID
ATTACKABLE = 6 * GRID  # within which SMAC offers a target to an agent

ARENA = ((0.0, 32 * GRID), (8 * GRID, 24 * GRID))  # x and y of the map's strip of open ground
AGENTS_START = (9 * GRID, 16 * GRID)  # where the enemies march to, too
ENEMIES_START = (23 * GRID, 16 * GRID)
SPACING = 1 * GRID  # of the formation that units start in
JITTER = 0.125 * GRID  # at the start, in x and y: too little to overlap

STOP, NORTH, SOUTH, EAST, WEST, FIRST_ATTACK = 1, 2, 3, 4, 5, 6  # actions; 0 is the no-op
DIRECTIONS = np.array([[0, 0], [0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]], np.float64)

KILL_REWARD, WIN_REWARD, MAXIMUM_RETURN = 10.0, 200.0, 20.0


@dataclass(frozen=True)
class Skirmish:
    """How many fight, and for how long."""

    agents: int
    enemies: int
    limit: int  # steps

    @property
    def units(self) -> int:
        return self.agents + self.enemies

    @property
    def choices(self) -> int:
        """Actions: no-op (of the dead), stop, north, south, east, west, attack enemy j."""
        return FIRST_ATTACK + self.enemies

    @property
    def reward_scale(self) -> float:
        """What makes the return of a won battle 20, however it was won."""
        return MAXIMUM_RETURN / (self.enemies * (HEALTH + KILL_REWARD) + WIN_REWARD)


class Battle:
    """E battles. Columns of every array (E, units) are the agents, then the enemies.

    Attributes:
        x, y: positions, 1/4096 of a cell. A unit stays where it died.
        health: points; 0 is dead.
        cooldown: game loops until the next shot.
    """

    def __init__(self, rules: Skirmish, copies: int) -> None:
        self.rules = rules
        shape = (copies, rules.units)
        self.x, self.y = np.zeros(shape), np.zeros(shape)
        self.health, self.cooldown = np.zeros(shape), np.zeros(shape)
        # Units by number over all copies: (E, units).
        self._numbers = np.arange(copies * rules.units).reshape(shape)
        self._first = self._numbers[:, :1]
        self._others = ~np.eye(rules.units, dtype=np.bool_)
        self._marching = np.arange(rules.units) >= rules.agents

    @property
    def alive(self) -> Bool:
        """(E, units)."""
        return self.health > 0

    def start(self, copy: int, random: np.random.Generator) -> None:
        """Begin one battle: both sides in their formations, unhurt."""
        count = (self.rules.agents, self.rules.enemies)
        starts = (AGENTS_START, ENEMIES_START)
        places = [_formation(n) + start for n, start in zip(count, starts, strict=True)]
        jitter = np.rint(random.uniform(-JITTER, JITTER, (self.rules.units, 2)))
        self.x[copy], self.y[copy] = (np.concatenate(places) + jitter).T
        self.health[copy], self.cooldown[copy] = HEALTH, 0.0

    def offsets(self) -> tuple[Float64, Float64, Float64]:
        """From agents to units: x and y in 1/4096 of a cell, and squared distances.

        Each (E, agents, units).
        """
        agents = self.rules.agents
        dx = self.x[:, None, :] - self.x[:, :agents, None]
        dy = self.y[:, None, :] - self.y[:, :agents, None]
        return dx, dy, dx * dx + dy * dy

    def available(self, squares: Float64) -> Bool:
        """Actions that SMAC would offer, (E, agents, choices), from `offsets`' squared distances.

        The dead have the no-op and nothing else; the living may stop, move where one cell further
        is open ground, and attack living enemies within 6 cells.
        """
        agents, alive = self.rules.agents, self.alive
        mask = np.zeros((len(alive), agents, self.rules.choices), np.bool_)
        mask[:, :, STOP] = True
        (left, right), (bottom, top) = ARENA
        x, y = self.x[:, :agents], self.y[:, :agents]
        mask[:, :, NORTH] = y + GRID < top
        mask[:, :, SOUTH] = y - GRID >= bottom
        mask[:, :, EAST] = x + GRID < right
        mask[:, :, WEST] = x - GRID >= left
        near = squares[:, :, agents:] <= ATTACKABLE**2
        mask[:, :, FIRST_ATTACK:] = near & alive[:, None, agents:]
        mask &= alive[:, :agents, None]
        mask[:, :, 0] = ~alive[:, :agents]
        return mask

    def advance(self, actions: NDArray[np.int64]) -> None:
        """One step of SMAC: 8 game loops with the agents' orders (E, agents), all available."""
        agents = self.rules.agents
        attacking = actions >= FIRST_ATTACK
        # Who aims at whom, by number; agents without a target aim at themselves.
        aim = self._numbers.copy()
        ordered = self._first + agents + actions - FIRST_ATTACK
        aim[:, :agents] = np.where(attacking, ordered, aim[:, :agents])
        way = DIRECTIONS[np.where(attacking, 0, actions)] * GRID
        for _ in range(LOOPS):
            self._loop(aim, way)
        self._push_apart()

    def _loop(self, aim: NDArray[np.int64], way: Float64) -> None:
        """One game loop: aim, shoot or move, all units at once."""
        agents, x, y, alive = self.rules.agents, self.x, self.y, self.alive
        # Enemies aim at the nearest agent; `offsets` would compute more than is needed here.
        dx = x[:, agents:, None] - x[:, None, :agents]
        dy = y[:, agents:, None] - y[:, None, :agents]
        squares = np.where(alive[:, None, :agents], dx * dx + dy * dy, np.inf)
        aim[:, agents:] = self._first + squares.argmin(axis=2)

        dx, dy = x.ravel()[aim] - x, y.ravel()[aim] - y
        square = dx * dx + dy * dy
        aiming = alive.ravel()[aim] & alive & (aim != self._numbers)
        aiming &= (square <= SIGHT * SIGHT) | ~self._marching
        in_reach = aiming & (square <= REACH * REACH)
        shooting = in_reach & (self.cooldown == 0)
        hits = np.bincount(aim[shooting], minlength=aim.size).reshape(aim.shape)

        # Towards the target; else agents go their way, and enemies march on.
        goal_x, goal_y = AGENTS_START
        dx[:, :agents] = np.where(aiming[:, :agents], dx[:, :agents], way[..., 0])
        dy[:, :agents] = np.where(aiming[:, :agents], dy[:, :agents], way[..., 1])
        dx[:, agents:] = np.where(aiming[:, agents:], dx[:, agents:], goal_x - x[:, agents:])
        dy[:, agents:] = np.where(aiming[:, agents:], dy[:, agents:], goal_y - y[:, agents:])
        share = np.minimum(SPEED / np.sqrt(np.maximum(dx * dx + dy * dy, 1.0)), 1.0)
        share *= alive & ~in_reach
        self._place(x + np.rint(dx * share), y + np.rint(dy * share))

        self.health = np.maximum(self.health - DAMAGE * hits, 0.0)
        self.cooldown = np.maximum(np.where(shooting, PERIOD, self.cooldown) - 1.0, 0.0)

    def _push_apart(self) -> None:
        """Living units that overlap part, each by half of what they overlap."""
        dx = self.x[:, :, None] - self.x[:, None, :]
        dy = self.y[:, :, None] - self.y[:, None, :]
        distance = np.sqrt(dx * dx + dy * dy)
        alive = self.alive
        overlap = np.maximum(2 * RADIUS - distance, 0.0)
        overlap *= alive[:, :, None] & alive[:, None, :] & self._others
        if not overlap.any():
            return
        share = overlap / 2 / np.maximum(distance, 1.0)
        self._place(
            self.x + np.rint(dx * share).sum(axis=2), self.y + np.rint(dy * share).sum(axis=2)
        )

    def _place(self, x: Float64, y: Float64) -> None:
        """Move units, but not out of the arena."""
        (left, right), (bottom, top) = ARENA
        self.x = np.minimum(np.maximum(x, left + RADIUS), right - RADIUS)
        self.y = np.minimum(np.maximum(y, bottom + RADIUS), top - RADIUS)


def _formation(count: int) -> Float64:
    """Offsets (count, 2) from the start point: columns of three, front to back as they come."""
    number = np.arange(count)
    return SPACING * np.stack([number // 3 - 0.5, number % 3 - 1.0], axis=1)
