"""A stand-in for the packages of the StarCraft Multi-Agent Challenge.

It implements the contract of SMAC's `StarCraft2Env` as its source states it (oxwhirl/smac,
`smac/env/starcraft2/starcraft2.py`): what is known before the game runs, that `step` takes
available actions only, its infos, its limit, and its silent answer to an error of the game's
protocol. Its game is that every order but the no-op hurts each enemy by one point.
"""

import os
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

MAPS = {"5m_vs_6m": (5, 6, 70), "2m_vs_1z": (2, 1, 150), "3m": (3, 3, 4)}
OBSERVATION, STATE, HEALTH = 7, 9, 10
GAME_VERSION = "4.10.0"
DIARY = "SMAC_STAND_IN_DIARY"  # names a file: at each start, how many games run in the process


class SC2LaunchError(Exception):
    pass


class StarCraft2Env:
    """See the module. Class attributes steer what a test wants to happen."""

    made: ClassVar[list["StarCraft2Env"]] = []
    running = 0  # games of this process that have not been closed
    missing = False  # no StarCraft II on this machine
    breaks_at: tuple[int, ...] = ()  # total steps at which the protocol fails, in each game
    kills_at: ClassVar[dict[int, int]] = {}  # step of an episode -> agent that dies

    def __init__(self, map_name="8m", seed=None, continuing_episode=False):
        self.n_agents, self.n_enemies, self.episode_limit = MAPS[map_name]
        self.n_actions = 6 + self.n_enemies
        self.seed, self.continuing_episode = seed, continuing_episode
        self.battles_won = self.battles_game = self.timeouts = self.force_restarts = 0
        self._controller, self._steps, self.closed = None, 0, False
        self.made.append(self)

    def get_env_info(self):
        return {
            "state_shape": STATE,
            "obs_shape": OBSERVATION,
            "n_actions": self.n_actions,
            "n_agents": self.n_agents,
            "episode_limit": self.episode_limit,
        }

    def _launch(self):
        if self.missing:
            raise SC2LaunchError("Expected to find StarCraft II installed at '/nowhere'.")
        type(self).running += 1
        if diary := os.environ.get(DIARY):
            with Path(diary).open("a") as file:
                print(self.running, file=file)
        self._controller = SimpleNamespace(ping=lambda: SimpleNamespace(game_version=GAME_VERSION))

    def reset(self):
        if self._controller is None:
            self._launch()
        self._time, self._enemies = 0, HEALTH
        self._alive = np.ones(self.n_agents, bool)
        return self.get_obs(), self.get_state()

    def step(self, actions):
        for agent, action in enumerate(actions):
            assert isinstance(action, int)
            assert self.get_avail_actions()[agent][action] == 1, "cannot perform action"
        self._steps += 1
        if self._steps in self.breaks_at:
            self.force_restarts += 1
            return 0, True, {}
        self._time += 1
        if self._time in self.kills_at:
            self._alive[self.kills_at[self._time]] = False
        hurt = sum(action > 1 for action in actions)
        self._enemies = max(self._enemies - hurt, 0)
        info = {"battle_won": False, "dead_allies": int((~self._alive).sum()), "dead_enemies": 0}
        terminated = False
        if not self._enemies or not self._alive.any():
            terminated, info["battle_won"] = True, bool(self._alive.any())
        elif self._time >= self.episode_limit:
            terminated = True
            if self.continuing_episode:
                info["episode_limit"] = True
            self.timeouts += 1
        self.battles_game += terminated
        self.battles_won += info["battle_won"]
        return 0.5 * hurt, terminated, info

    def get_obs(self):
        alive = self._alive[:, None]
        rows = np.arange(OBSERVATION) + 10 * np.arange(self.n_agents)[:, None] + self._time / 100
        return list((rows * alive).astype(np.float32))

    def get_state(self):
        return np.full(STATE, self._time + 1000 * self._enemies, np.float32)

    def get_avail_actions(self):
        masks = np.zeros((self.n_agents, self.n_actions), int)
        masks[self._alive, 1:4] = 1
        masks[~self._alive, 0] = 1
        return masks.tolist()

    def get_stats(self):
        return {
            "battles_won": self.battles_won,
            "battles_game": self.battles_game,
            "timeouts": self.timeouts,
            "restarts": self.force_restarts,
        }

    def close(self):
        self.closed = True
        if self._controller is not None:
            type(self).running -= 1


class _Flags:
    """Flags of absl: to be parsed before the game starts."""

    parsed = False

    def is_parsed(self):
        return self.parsed

    def __call__(self, arguments):
        self.parsed = True


FLAGS = _Flags()


def get_smac_map_registry():
    return MAPS


# What this file stands in for: module -> the name that is looked up in it.
MODULES = {
    "smac.env": "StarCraft2Env",
    "smac.env.starcraft2.maps.smac_maps": "get_smac_map_registry",
    "pysc2.lib.sc_process": "SC2LaunchError",
    "absl.flags": "FLAGS",
}


def install(patch: pytest.MonkeyPatch) -> type[StarCraft2Env]:
    """Put the stand-in in the packages' place; returns a class of this test's own."""
    own = type("StarCraft2Env", (StarCraft2Env,), {"made": []})
    contents = {**globals(), "StarCraft2Env": own, "FLAGS": _Flags()}
    for name, wanted in MODULES.items():
        parts = name.split(".")
        for parent in (".".join(parts[:length]) for length in range(1, len(parts))):
            if parent not in MODULES:
                patch.setitem(sys.modules, parent, _package(parent))
        module = _package(name)
        setattr(module, wanted, contents[wanted])
        patch.setitem(sys.modules, name, module)
    return own


def _package(name: str) -> ModuleType:
    module = ModuleType(name)
    module.__path__ = []
    return module


def write(folder: Path) -> dict[str, str]:
    """Write the packages to a folder; the environment in which processes find them there."""
    for name, wanted in MODULES.items():
        package = folder.joinpath(*name.split("."))
        package.mkdir(parents=True, exist_ok=True)
        (package / "__init__.py").write_text(f"from smac_stand_in import {wanted}\n")
    paths = (folder, Path(__file__).parent, os.environ.get("PYTHONPATH", ""))
    return {**os.environ, "PYTHONPATH": os.pathsep.join(str(path) for path in paths if path)}
