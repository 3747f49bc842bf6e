"""Maps of the StarCraft Multi-Agent Challenge, through its own `StarCraft2Env`: "smac/5m_vs_6m".

The package (`oxwhirl/smac`), StarCraft II and SMAC's maps are the user's to install; nothing of
them is imported before an environment is asked for. Observations are SMAC's, with the mask of the
available actions after them. What the game does not offer is not offered here:

- A seed: an episode cannot be chosen. The game process of a copy is given its first episode's
  seed, and goes on from there, so neither runs nor data sets are repeatable.
- A state to go back to: `state` is SMAC's global state for the log, `set_state` is refused, and a
  deployment that is cut off cannot be resumed.

After an error of the game's protocol SMAC restarts the game and returns (0, True, {}), as if a
battle had ended. Such a step did not happen: it is marked as both terminated and truncated, s' is
s, the episode does not count, and no learner learns from the step (see `Outcome`).
"""

import importlib
import logging
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.envs.base import Outcome, at_least_one
from otc_dist.envs.discrete_actions import chosen
from otc_dist.envs.family import FOREIGN_TRANSITIONS, Family, RandomData
from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.terminal.errors import UserError, unknown
from otc_dist.transitions import Bool, Float32, Float64

PREFIX = "smac/"
MOST_COPIES = 8  # games at a time where nobody says how many: each is a process of a gigabyte

_SOURCE = "git+https://github.com/oxwhirl/smac.git"
_PACKAGE = f"{sys.executable} -m pip install {_SOURCE} (PyPI's `smac` is another package)"
_GAME = "install StarCraft II and SMAC's maps as https://github.com/oxwhirl/smac says, set SC2PATH"
_DISTRIBUTIONS = ("SMAC", "PySC2", "s2clientprotocol")

log = logging.getLogger(__name__)


def knows(env_id: str) -> bool:
    """Whether the id names a map; which maps there are is SMAC's to say."""
    return env_id.startswith(PREFIX)


@cache
def team_spec(env_id: str) -> TeamSpec:
    """The team of a map, without starting the game.

    Raises:
        UserError: SMAC is not installed, or has no such map.
    """
    game = _game(env_id)
    info = game.get_env_info()
    game.close()
    choices = int(info["n_actions"])
    return TeamSpec(
        env_id=env_id,
        agents=tuple(
            AgentSpec(
                f"agent_{i}",
                int(info["obs_shape"]) + choices,
                (0.0,),
                (choices - 1.0,),
                choices=choices,
            )
            for i in range(int(info["n_agents"]))
        ),
        state_size=int(info["state_shape"]),
        max_episode_steps=int(info["episode_limit"]),
    )


def versions() -> dict[str, str]:
    """Of the packages that drive the game."""
    found = {}
    for package in _DISTRIBUTIONS:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _game(env_id: str, seed: int | None = None) -> Any:
    """A `StarCraft2Env` of the map, whose game is not started yet."""
    try:
        made = importlib.import_module("smac.env").StarCraft2Env
        maps = importlib.import_module("smac.env.starcraft2.maps.smac_maps")
    except ModuleNotFoundError as error:
        raise UserError(f"{env_id} needs SMAC, and {error.name} is missing: {_PACKAGE}") from None
    known, name = maps.get_smac_map_registry(), env_id.removeprefix(PREFIX)
    if name not in known:
        raise unknown("SMAC map", name, known)
    # With `continuing_episode`, infos distinguish an end at the limit from a battle's.
    return made(map_name=name, seed=seed, continuing_episode=True)


class SmacEnv:
    """E games of StarCraft II, a `BatchedEnv` with discrete actions. See the module.

    Raises:
        UserError: SMAC is not installed, has no such map, or, at the first `reset`, StarCraft II
            cannot be started.
        ValueError: fewer than one copy.
    """

    def __init__(self, env_id: str, copies: int) -> None:
        self.spec = team_spec(env_id)
        self.copies = at_least_one(copies)
        self._games: list[Any] = [None] * copies  # each from its first reset on
        self._won = np.zeros(copies, np.bool_)
        self._state = np.zeros((copies, self.spec.state_size))
        sizes = [agent.observation_size for agent in self.spec.agents]
        self._seen = np.zeros((len(sizes), copies, sizes[0]), np.float32)

    @property
    def success(self) -> Bool:
        """Which battles the last step won, (E,)."""
        return self._won

    @property
    def versions(self) -> Mapping[str, str]:
        """Of the game and of what drives it; the game's is known once it runs."""
        found = versions()
        running = next((game for game in self._games if game is not None), None)
        if running is not None:
            found["StarCraft II"] = str(running._controller.ping().game_version)
        return found

    def reset(self, which: NDArray[np.int64], seeds: NDArray[np.int64]) -> None:
        """Start the next battle in the copies `which`; only a copy's first seed is used.

        Raises:
            UserError: StarCraft II cannot be started.
        """
        for copy, seed in zip(which.tolist(), seeds.tolist(), strict=True):
            if self._games[copy] is None:
                self._games[copy] = _launched(self.spec.env_id, seed)
            else:
                self._games[copy].reset()
            self._see(copy)

    def _see(self, copy: int) -> None:
        game = self._games[copy]
        self._seen[:, copy] = np.concatenate([game.get_obs(), game.get_avail_actions()], axis=1)
        self._state[copy] = game.get_state()

    def observe(self) -> tuple[Float32, ...]:
        """See `BatchedEnv.observe`."""
        return tuple(self._seen.copy())

    def step(self, actions: Sequence[Float32]) -> Outcome:
        """See `BatchedEnv.step`. Raises ValueError for an action that is not available, too."""
        choices = self.spec.agents[0].choices
        orders = chosen(self.spec, actions, self._seen[:, :, -choices:].swapaxes(0, 1) > 0)
        rewards = np.zeros(self.copies, np.float32)
        terminated, truncated = np.zeros((2, self.copies), np.bool_)
        self._won = np.zeros(self.copies, np.bool_)
        for copy, game in enumerate(self._games):
            reward, ended, info = game.step(orders[copy].tolist())
            if ended and not info:
                log.warning("StarCraft II broke off in copy %d: its episode does not count", copy)
                terminated[copy] = truncated[copy] = True
                continue
            rewards[copy] = reward
            truncated[copy] = bool(info.get("episode_limit", False))
            terminated[copy] = ended and not truncated[copy]
            self._won[copy] = bool(info["battle_won"])
            self._see(copy)
        return Outcome((rewards,) * len(self.spec.agents), terminated, truncated)

    def state(self) -> Float64:
        """SMAC's global state, (E, state_size): to look at, not to go back to."""
        return self._state.copy()

    def set_state(self, state: Float64) -> None:
        """Refused. Raises UserError: the game cannot go back to a state."""
        del state
        raise UserError(f"{self.spec.env_id} cannot go back to a state: StarCraft II cannot")

    def close(self) -> None:
        """End the games."""
        for game in self._games:
            if game is not None:
                game.close()


def _launched(env_id: str, seed: int) -> Any:
    """A game that runs, in its first battle. Raises UserError if it does not start."""
    game = _game(env_id, seed % 2**31)
    flags = importlib.import_module("absl.flags").FLAGS
    if not flags.is_parsed():  # PySC2 reads its own; nobody else parses them (oxwhirl/smac#126)
        flags(["otc_dist"])
    launch_error = importlib.import_module("pysc2.lib.sc_process").SC2LaunchError
    try:
        game.reset()
    except (OSError, ValueError, launch_error) as error:
        raise UserError(f"StarCraft II cannot be started ({error}): {_GAME}") from None
    return game


FAMILY = Family(
    knows,
    team_spec,
    lambda env_id, copies, progress: SmacEnv(env_id, copies),
    most_copies=MOST_COPIES,
    random_data=RandomData(FOREIGN_TRANSITIONS, lambda env_id: versions()),
)
