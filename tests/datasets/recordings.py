"""Recordings as others write them, made by playing a robot: D4RL's layout, with true successors."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from otc_dist.datasets.importers import import_file
from otc_dist.envs.robots import RobotEnv
from otc_dist.terminal.errors import UserError


@dataclass
class Played:
    """T steps of one copy, episode after episode; an episode is cut at `limit` steps."""

    observations: NDArray[Any]
    actions: NDArray[Any]
    rewards: NDArray[Any]
    successors: NDArray[Any]
    terminals: NDArray[Any]
    timeouts: NDArray[Any]
    qpos: NDArray[Any]
    qvel: NDArray[Any]

    @property
    def ends(self) -> NDArray[Any]:
        return np.flatnonzero(self.terminals | self.timeouts)


def play(env_id: str, steps: int, limit: int = 15) -> Played:
    """Uniform actions of the single-agent `env_id`."""
    env = RobotEnv(env_id, 1)
    draw = np.random.default_rng(0)
    joints = (env.spec.agents[0].observation_size + 1) // 2
    rows: list[tuple[Any, ...]] = []
    episode = length = 0
    env.reset(np.array([0]), np.array([episode]))
    for _ in range(steps):
        action = draw.uniform(-1, 1, (1, env.spec.agents[0].action_size)).astype(np.float32)
        before, state = env.observe()[0][0], env.state()[0]
        outcome = env.step([action])
        length += 1
        terminal = bool(outcome.terminated[0])
        timeout = length == limit and not terminal
        rows.append(
            (
                before,
                action[0],
                outcome.rewards[0][0],
                env.observe()[0][0],
                terminal,
                timeout,
                state[1 : 1 + joints],
                state[1 + joints : 1 + 2 * joints],
            )
        )
        if terminal or timeout:
            episode, length = episode + 1, 0
            env.reset(np.array([0]), np.array([episode]))
    return Played(*(np.array(column) for column in zip(*rows, strict=True)))


def write_d4rl(path: Path, played: Played, *, leave_out: str = "", **replaced: Any) -> Path:
    """Write D4RL's layout, without the arrays in `leave_out` and with others `replaced`."""
    names = {"successors": "next_observations", "qpos": "infos/qpos", "qvel": "infos/qvel"}
    arrays = {names.get(f.name, f.name): getattr(played, f.name) for f in fields(played)}
    arrays.update(replaced)
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            if name not in leave_out.split():
                file.create_dataset(name, data=array)
    return path


def refusal(source: Path, level: str = "mine", env_id: str = "") -> str:
    with pytest.raises(UserError) as caught:
        import_file(source, level, env_id)
    assert "\n" not in str(caught.value)
    return str(caught.value)
