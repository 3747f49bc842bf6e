"""How the particle tasks look: discs in a square."""

import numpy as np

from otc_dist.envs import navigation, predator_prey
from otc_dist.envs.particle_family import team_spec
from otc_dist.envs.predator_prey import COLLISION
from otc_dist.scenes.scene import FOE, GOAL, Body, Frames, View, agent_colour, disc
from otc_dist.transitions import Float64

_RADIUS = COLLISION / 2  # bodies that touch are what Predator-Prey counts as a collision
_ARENA = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))


class ParticleScene:
    """Agents, and the prey or the landmarks."""

    def __init__(self, env_id: str) -> None:
        names = team_spec(env_id).names
        agents = [Body(name, agent_colour(i), disc(_RADIUS)) for i, name in enumerate(names)]
        # Navigation's landmark stands in the origin and is no part of the state.
        standing, others = [], []
        if env_id == navigation.ENV_ID:
            standing = [Body("landmark", GOAL, disc(navigation.REACHED), solid=False)]
        elif env_id == predator_prey.team_spec(len(names)).env_id:
            others = [Body("prey", FOE, disc(_RADIUS))]
        else:
            others = [
                Body(f"landmark_{j}", GOAL, disc(_RADIUS), solid=False) for j in range(len(names))
            ]
        self._standing = len(standing)
        self.bodies = (*standing, *agents, *others)
        self.view = View((0.0, 0.0), 2.2, 2.2, _ARENA)
        self.choices = ()
        self.seconds = 0.1

    def frames(self, states: Float64) -> Frames:
        """See `Scene.frames`; a state is the elapsed steps, then x and y of every point."""
        count, moving = len(states), len(self.bodies) - self._standing
        poses = np.zeros((count, len(self.bodies), 3))
        points = states[:, 1 : 1 + 2 * moving]
        poses[:, self._standing :, :2] = points.reshape(count, moving, 2)
        return Frames(poses, np.ones((count, len(self.bodies))))
