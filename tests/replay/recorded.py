"""Logs with their steps, and what an export of an agent has to hold."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.transitions import JointStep

# Of one agent: observations, actions, rewards, next_observations, terminated, truncated, and
# starts (of the trajectories), as far as a format has them.
Arrays = dict[str, NDArray[Any]]


@dataclass
class Deployments:
    """Logs, and the steps of each."""

    paths: list[Path]
    steps: list[list[JointStep]]

    def trajectories(self) -> list[list[tuple[int, int, JointStep]]]:
        """(log, copy, step) of every trajectory, in the order of their ends."""
        found = []
        for log, steps in enumerate(self.steps):
            copies = len(steps[0].terminated)
            waiting: list[list[tuple[int, int, JointStep]]] = [[] for _ in range(copies)]
            for step in steps:
                for copy in range(copies):
                    waiting[copy].append((log, copy, step))
                    if step.terminated[copy] or step.truncated[copy]:
                        found.append(waiting[copy])
                        waiting[copy] = []
            found += [part for part in waiting if part]
        return found

    def of_agent(self, index: int) -> Arrays:
        """What an export of that agent has to hold."""
        parts = self.trajectories()
        rows = [row for part in parts for row in part]

        def stacked(name: str) -> NDArray[Any]:
            return np.array([getattr(step, name)[index][copy] for _, copy, step in rows])

        return {
            "observations": stacked("observations"),
            "actions": stacked("actions"),
            "rewards": stacked("rewards"),
            "next_observations": stacked("next_observations"),
            "terminated": np.array([step.terminated[copy] for _, copy, step in rows]),
            "truncated": np.array([step.truncated[copy] for _, copy, step in rows]),
            "exploring": np.array([step.exploring[index] for _, _, step in rows]),
            "starts": np.cumsum([0, *(len(part) for part in parts[:-1])]),
            "log": np.array([log for log, _, _ in rows]),
            "copy": np.array([copy for _, copy, _ in rows]),
            "step": np.array([step.step for _, _, step in rows]),
        }
