"""What one agent concludes of the deployments, from its own rewards and by itself.

All agents get the team's reward, so that all come to the same conclusion without a message.
"""

import json

from otc_dist.run import recommendation
from otc_dist.run.measured_returns import Measured, horizon, measure
from otc_dist.system import durable
from otc_dist.transitions import Transitions

from .gathering import Fetch
from .process import Run


class Recommender:
    """Measures every deployment once: as it is taken, or from the log where it is missed.

    Args:
        name: of the agent.
        fetch: where a deployment comes from that this process did not see (it was restarted).
    """

    def __init__(self, run: Run, name: str, fetch: Fetch) -> None:
        self._name, self._fetch = name, fetch
        self._folder, self._settings = run.folder, run.description.deployment
        self._steps, self._copies = run.schedule.steps, run.description.env.copies
        self._h = horizon(self._steps, self._copies, run.team.max_episode_steps)
        self._measured: dict[int, Measured] = {}

    @property
    def keeps_best(self) -> bool:
        """Whether the deployments are compared; if not, nothing is measured here."""
        return self._settings.keep == "best"

    def take(self, deployment: int, data: Transitions) -> None:
        """Measure a deployment by its transitions, all of them, by step and then by copy.

        Raises:
            UserError: it holds too few episodes.
        """
        if not self.keeps_best:
            return
        shape = (self._steps, self._copies)
        self._measured[deployment] = measure(
            data.rewards.reshape(shape),
            data.terminated.reshape(shape),
            data.truncated.reshape(shape),
            self._h,
        )

    def reverted(self, deployment: int) -> int | None:
        """k of the policy from which tuning after a deployment goes on, if not from the newest."""
        return recommendation.reverted(self._up_to(deployment)) if self._settings.revert else None

    def recommend(self, deployments: int, tuned: int) -> None:
        """Write which of this agent's checkpoints is recommended, after so many deployments.

        Raises:
            UserError: the file cannot be written.
        """
        keep = self._settings.keep or "last"
        measured = self._up_to(deployments) if self.keeps_best else [None] * deployments
        found = recommendation.recommended(keep, measured, tuned)
        content = {
            "agent": self._name,
            "checkpoint": self._folder.checkpoint(self._name, found.policy).name,
            "policy": found.policy,
            "deployment": found.deployment,
            "keep": keep,
        }
        lines = json.dumps(content, indent=1) + "\n"
        durable.put(self._folder.recommended(self._name), lines.encode())

    def _up_to(self, deployment: int) -> list[Measured]:
        for k in range(1, deployment + 1):
            if k not in self._measured:
                self.take(k, self._fetch(k, 0, self._steps))
        return [self._measured[k] for k in range(1, deployment + 1)]
