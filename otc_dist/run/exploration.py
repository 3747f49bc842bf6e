"""Sequential exploration: one agent after another explores while the others exploit.

An agent's data then follow the transition dynamics of the others' learned policies, as OTC needs,
and still hold actions that its own policy would not take (the paper's SMAC experiment). It costs
N M transitions per deployment instead of M.
"""

from dataclasses import dataclass

import numpy as np

from otc_dist.description import DeploymentSection, Description
from otc_dist.transitions import Float32


@dataclass(frozen=True)
class Schedule:
    """Who explores in which lock-step of a deployment, and which steps an agent keeps.

    Attributes:
        turn: lock-steps in which M transitions are made: M / E.
        agents: N.
        sequential: whether each agent has a turn of its own to explore; else nobody explores.
    """

    turn: int
    agents: int
    sequential: bool

    @classmethod
    def of(cls, description: Description, agents: int) -> "Schedule":
        """The schedule of every deployment of a resolved description."""
        deployment = description.deployment
        turn = deployment.transitions // description.env.copies
        return cls(turn, agents, deployment.exploration == "sequential")

    @property
    def steps(self) -> int:
        """Lock-steps of a deployment."""
        return self.turn * self.rounds

    @property
    def rounds(self) -> int:
        """How many times M transitions a deployment costs: N, or 1 if nobody explores."""
        return self.agents if self.sequential else 1

    def exploring(self, step: int) -> tuple[bool, ...]:
        """Behaviour tags (N) of a step."""
        return tuple(self.sequential and step // self.turn == i for i in range(self.agents))

    def own(self, agent: int) -> range:
        """Steps of which agent number `agent` keeps its transitions, as D_k: M / E of them."""
        start = agent * self.turn if self.sequential else 0
        return range(start, start + self.turn)


def explore(
    actions: Float32, observations: Float32, choices: int, settings: DeploymentSection,
    random: np.random.Generator,
) -> Float32:  # fmt: skip
    """What an exploring agent does instead of its policy's `actions` (E, a).

    Continuous actions, scaled to [-1, 1]: normal noise is added. Discrete ones: with a small
    probability one of the available actions, uniformly.

    Args:
        observations: (E, s), whose last `choices` entries are the masks of discrete actions.
    """
    if not choices:
        noise = random.standard_normal(actions.shape, np.float32)
        return np.clip(actions + np.float32(settings.exploration_noise) * noise, -1, 1)
    available = observations[:, -choices:] > 0
    others = np.where(available, random.random(available.shape, np.float32), -1).argmax(axis=1)
    chosen = random.random(len(actions)) < settings.exploration_rate
    return np.where(chosen[:, None], others[:, None], actions).astype(np.float32)
