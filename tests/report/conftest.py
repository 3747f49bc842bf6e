"""Run folders as the launcher, the env host and the learners leave them, made by hand."""

import json
from pathlib import Path

import numpy as np
import pytest

from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.description import Description
from otc_dist.run.folder import RunFolder
from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.transitions import JointStep


class MadeRun:
    """A run of two agents and three deployments; each part can be left out or changed."""

    def __init__(self, root: Path) -> None:
        self.folder = RunFolder(root)
        self.description = Description.build(
            {
                "name": "made",
                "summary": "made by hand",
                "env": {"id": "hopper-3x1"},
                "dataset": {"name": "hopper-3x1/medium-replay", "transitions": 1000},
                "deployment": {"count": 3, "updates": 100, "keep": "best"},
                "evaluation": {"episodes": 2},
                "seed": 5,
            }
        )
        for folder in ("evaluations", "deployments"):
            (root / folder).mkdir(parents=True)
        self.folder.description.write_text(self.description.to_toml())
        self.folder.dataset_card.write_text(
            json.dumps(
                {
                    "name": "hopper-3x1/medium-replay",
                    "returns": {"mean": 10.0, "std": 2.0, "minimum": 5.0, "maximum": 15.0},
                    "files": {"agent_0": {"sha256": "ab" * 32}},
                }
            )
        )
        self.write_record()
        for k, returns in enumerate([[-10.0, -30.0], [-10.0, -10.0], [0.0, 20.0], [10.0, 30.0]]):
            self.evaluate(k, returns)
        for k, returns in enumerate([[1.0, 3.0], [4.0, 8.0], [2.0, 4.0]], 1):
            self.deploy(k, returns)
        for agent in ("agent_0", "agent_1"):
            self.folder.agent(agent).mkdir(parents=True)
            self.report(agent, "embedding", 0, 50, 50, loss=0.5, active_dimensions=7.0)
            self.report(agent, "offline", 0, 0, 200, loss=2.0)
            self.report(agent, "offline", 0, 200, 200, loss=1.0)
            for k in (1, 2, 3):
                self.report(agent, "tuning", k, 0, 100, alpha=1.0 / k, similarity=3.0 / k)
                self.report(agent, "tuning", k, 100, 100, loss=1.0 / k)

    def write_record(self, **changes: object) -> None:
        record = {
            "run": "made-1",
            "command": ["python", "-m", "otc_dist.launch", "made", "--set", "env.copies=1 2"],
            "versions": {"torch": "2.7.0"},
            "started": "2026-01-01T10:00:00+00:00",
            "finished": "2026-01-01T11:30:00+00:00",
            "quick": False,
            "state": "finished",
            **changes,
        }
        self.folder.run_json.write_text(json.dumps(record))

    def evaluate(self, k: int, returns: list[float]) -> None:
        self.folder.evaluation(k).write_text(
            json.dumps(
                {
                    "evaluation": k,
                    "policies": {"agent_0": f"digest {k}"},
                    "returns": returns,
                    "lengths": [100, 200],
                    "seeds": [1, 2],
                    "mean_return": sum(returns) / 2,
                    "normalised_score": sum(returns) / 20,
                }
            )
        )

    def deploy(self, k: int, returns: list[float]) -> None:
        """Two copies of an episode, of which half counts, with these returns until then."""
        agents = tuple(AgentSpec(f"agent_{i}", 1, (-1.0,), (1.0,)) for i in range(2))
        team, copies, steps = TeamSpec("hopper-3x1", agents, 0, 8), len(returns), 16
        header = LogHeader("made-1", k, 5, "", "0" * 16, team, copies)
        writer = LogWriter.create(self.folder.deployment(k), header)
        numbers, never = np.zeros((copies, 1), np.float32), np.zeros(copies, bool)
        rewards = np.float32(returns) / 8
        for step in range(steps):
            writer.write(
                JointStep(
                    step=step,
                    observations=(numbers,) * 2,
                    actions=(numbers,) * 2,
                    rewards=(rewards if step < 8 else 0 * rewards,) * 2,
                    next_observations=(numbers,) * 2,
                    terminated=never,
                    truncated=never,
                    exploring=(False, False),
                    episode_seeds=np.arange(copies),
                    state=np.zeros((copies, 0)),
                )
            )
        writer.finish({agent.name: f"digest {k - 1}" for agent in agents})

    def describe(self, *assignments: str) -> None:
        """Change the run's description."""
        self.description = self.description.with_assignments(*assignments)
        self.folder.description.write_text(self.description.to_toml())

    def report(
        self, agent: str, phase: str, k: int, update: int, updates: int, **metrics: float
    ) -> None:
        line = {
            "phase": phase, "deployment": k, "update": update, "updates": updates,
            "metrics": metrics,
        }  # fmt: skip
        with self.folder.metrics(agent).open("a") as stream:
            stream.write(json.dumps(line) + "\n")


@pytest.fixture
def made(tmp_path: Path) -> MadeRun:
    return MadeRun(tmp_path / "run")
