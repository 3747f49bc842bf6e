"""Between an agent's own actions and those that its algorithm knows."""

import numpy as np

from otc_dist.spec import AgentSpec
from otc_dist.transitions import Float32


class ActionScale:
    """Continuous actions are scaled from the agent's bounds to [-1, 1]; indices stay indices.

    Attributes:
        centre, scale: of what an algorithm knows as 0 and 1, (a,); low, high: the bounds, (a,).
    """

    def __init__(self, spec: AgentSpec) -> None:
        low, high = np.array([spec.action_low, spec.action_high], np.float32)
        if spec.choices:
            self.centre: Float32 = np.zeros_like(low)
            self.scale: Float32 = np.ones_like(low)
        else:
            self.centre = (low + high) / np.float32(2)
            self.scale = (high - low) / np.float32(2)
        self.low, self.high = low, high

    def scaled(self, actions: Float32) -> Float32:
        """Actions (N, a) as the algorithm knows them."""
        return (actions - self.centre) / self.scale

    def unscaled(self, actions: Float32) -> Float32:
        """Actions (N, a) as the environment knows them, within the agent's bounds."""
        exact = actions * self.scale + self.centre
        # Rounding may exceed bounds by a bit.
        clipped: Float32 = np.clip(exact, self.low, self.high)
        return clipped
