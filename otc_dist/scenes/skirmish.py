"""How a skirmish looks: units as discs in the strip of open ground, from above.

Lengths are 8 cells, so that the arena is about as high as a robot or the particles' square and
one view serves all.
"""

import numpy as np

from otc_dist.envs.skirmish import SKIRMISHES
from otc_dist.envs.skirmish_rules import ARENA, GRID, HEALTH, RADIUS
from otc_dist.scenes.scene import FOE, Body, Frames, View, agent_colour, disc
from otc_dist.transitions import Float64

_UNIT = 8 * GRID
_MARGIN = 0.1


class SkirmishScene:
    """Agents and enemies; a level is a unit's share of its health."""

    def __init__(self, env_id: str) -> None:
        rules = SKIRMISHES[env_id]
        radius = disc(RADIUS / _UNIT)
        self.bodies = (
            *(Body(f"agent_{i}", agent_colour(i), radius) for i in range(rules.agents)),
            *(Body(f"enemy_{j}", FOE, radius) for j in range(rules.enemies)),
        )
        (left, right), (bottom, top) = ((low / _UNIT, high / _UNIT) for low, high in ARENA)
        self.view = View(
            ((left + right) / 2, (bottom + top) / 2),
            right - left + 2 * _MARGIN,
            top - bottom + 2 * _MARGIN,
            ((left, bottom), (right, bottom), (right, top), (left, top)),
        )
        attacks = (f"attack {j}" for j in range(rules.enemies))
        self.choices = ("no-op", "stop", "north", "south", "east", "west", *attacks)
        self.seconds = 0.2

    def frames(self, states: Float64) -> Frames:
        """See `Scene.frames`; a state is the elapsed steps, then x, y, health and cooldown of all
        units.
        """
        x, y, health, _ = np.split(states[:, 1:], 4, axis=1)
        poses = np.stack((x / _UNIT, y / _UNIT, np.zeros_like(x)), axis=2)
        return Frames(poses, health / HEALTH)
