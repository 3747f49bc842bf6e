"""Between an agent's own actions and those that its algorithm knows."""

import numpy as np

from otc_dist.spec import AgentSpec
from otc_dist.transitions import Float32


class ActionScale:
    """Continuous actions are scaled from the agent's bounds to [-1, 1]; indices stay indices."""

    def __init__(self, spec: AgentSpec) -> None:
        low, high = np.array([spec.action_low, spec.action_high], np.float32)
        if spec.choices:
            self._centre: Float32 = np.zeros_like(low)
            self._scale: Float32 = np.ones_like(low)
        else:
            self._centre = (low + high) / np.float32(2)
            self._scale = (high - low) / np.float32(2)
        self._low, self._high = low, high

    def scaled(self, actions: Float32) -> Float32:
        """Actions (N, a) as the algorithm knows them."""
        return (actions - self._centre) / self._scale

    def unscaled(self, actions: Float32) -> Float32:
        """Actions (N, a) as the environment knows them, within the agent's bounds."""
        exact = actions * self._scale + self._centre
        # Rounding may exceed bounds by a bit.
        clipped: Float32 = np.clip(exact, self._low, self._high)
        return clipped
