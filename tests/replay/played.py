"""Short deployments of real environments, played at random."""

from pathlib import Path

import numpy as np

from otc_dist import names
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Float32, JointStep


class Playing:
    """A deployment that goes on: `steps` are those that its log at `path` has."""

    def __init__(
        self, env_id: str, path: Path, copies: int = 2, *, run: str = "", deployment: int = 2
    ) -> None:
        self._env = env = registry.make(env_id, copies, 0.0)
        header = LogHeader(
            run=run or f"played-{names.from_text(env_id)}",
            deployment=deployment,
            seed=5,
            description="",
            description_digest="0" * 16,
            team=env.spec,
            copies=copies,
        )
        self._rollout = Rollout(env, 5, "deployment", deployment)
        self._rng = np.random.default_rng(0)
        self._writer = LogWriter.create(path, header)
        self.steps: list[JointStep] = []

    def take(self, steps: int) -> None:
        """So many more."""
        agents, rollout = self._env.spec.agents, self._rollout
        for _ in range(steps):
            actions = [
                _action(agent, seen, self._rng)
                for agent, seen in zip(agents, rollout.observations, strict=True)
            ]
            self.steps.append(rollout.advance(actions, (False,) * len(actions)))
            self._writer.write(self.steps[-1])

    def finish(self) -> None:
        """Finish the log."""
        self._writer.finish({})
        self._env.close()


def play(
    env_id: str, path: Path, steps: int, copies: int = 2, *, run: str = "", deployment: int = 2
) -> list[JointStep]:
    """Record a deployment at `path` and finish its log; its steps."""
    playing = Playing(env_id, path, copies, run=run, deployment=deployment)
    playing.take(steps)
    playing.finish()
    return playing.steps


def _action(agent: AgentSpec, seen: Float32, rng: np.random.Generator) -> Float32:
    if agent.choices:
        masks = seen[:, -agent.choices :]
        return np.array([[rng.choice(np.flatnonzero(mask))] for mask in masks], np.float32)
    low, high = np.array(agent.action_low), np.array(agent.action_high)
    return rng.uniform(low, high, (len(seen), len(low))).astype(np.float32)
