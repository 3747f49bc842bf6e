"""Two carts on a track that wait for nobody: an environment around devices, without hardware.

    python -m otc_dist.launch navigation --set env.id=fake_robots:parallel_env ...

docs/robots.md has the rest of the command, and says what such an environment promises. `Device`
stands for what is not Python: it moves by a clock of its own, by the newest command that it has,
and its samples come late at random. `Carts` is what you would write. `simulated` is a twin without
a clock, to make data of.
"""

import random
import threading
import time
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

CARTS = ("left", "right")
PERIOD = 1 / 50  # seconds from one sample to the next
LATE = 0.1  # share of samples that come late
LONGEST = 2.5  # periods by which they do
SILENCE = 2.0  # seconds without a command, after which the device stops by itself

Numbers = NDArray[np.float32]


def moved(positions: Numbers, speeds: Numbers) -> Numbers:
    """Where the carts are one period later: the track is [-1, 1]."""
    return np.clip(positions + np.float32(PERIOD) * speeds, -1, 1).astype(np.float32)


class Device:
    """Both carts: samples by a thread of their own, whoever listens."""

    def __init__(self, positions: Numbers) -> None:
        self._positions, self._speeds = positions, np.zeros(2, np.float32)
        self._commanded = time.monotonic()
        self._sample, self._number, self._taken = positions, 0, 0
        self._news, self._off = threading.Condition(), threading.Event()
        self._thread = threading.Thread(target=self._tick, name="device", daemon=True)
        self._thread.start()

    def _tick(self) -> None:
        tick = time.monotonic()
        while not self._off.wait(max(0.0, tick - time.monotonic())):
            tick += PERIOD
            if time.monotonic() - self._commanded > SILENCE:
                self._speeds = np.zeros(2, np.float32)
            self._positions = moved(self._positions, self._speeds)
            if random.random() < LATE:
                self._off.wait(random.uniform(0, LONGEST) * PERIOD)
            with self._news:
                self._sample, self._number = self._positions, self._number + 1
                self._news.notify_all()

    def command(self, speeds: Numbers) -> None:
        """Move so from now on."""
        self._speeds, self._commanded = speeds, time.monotonic()

    def sample(self, timeout: float = 1.0) -> Numbers:
        """The newest sample that was not given yet; waits for one if there is none."""
        with self._news:
            if not self._news.wait_for(lambda: self._number > self._taken, timeout):
                raise TimeoutError(f"the device has sent nothing for {timeout:g} s")
            self._taken = self._number
            return self._sample

    def close(self) -> None:
        """At rest, and off."""
        self._off.set()
        self._thread.join()


class Carts(ParallelEnv):  # type: ignore[misc]  # PettingZoo is untyped
    """The carts are to meet: both get the same reward, minus the distance between them."""

    metadata: ClassVar = {"name": "carts"}
    max_cycles = 100

    def __init__(self) -> None:
        # Nothing is opened here: launcher and learners make one, too, to see its spaces.
        self.possible_agents = list(CARTS)
        self.device: Device | None = None

    def observation_space(self, agent: str) -> Box:
        return Box(-1, 1, (2,), np.float32)

    def action_space(self, agent: str) -> Box:
        return Box(-1, 1, (1,), np.float32)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Numbers], dict[str, dict[str, Any]]]:
        """Nothing moves from here to the first step."""
        self.agents, self._steps = list(CARTS), 0
        if self.device is not None:
            self.device.close()
        starts = np.random.default_rng(seed).uniform(-1, 1, 2).astype(np.float32)
        self.device = Device(starts)  # a person, or the device itself, has put them there
        return self._seen(self.device.sample()), {name: {} for name in CARTS}

    def _seen(self, positions: Numbers) -> dict[str, Numbers]:
        """Each sees itself first."""
        return {"left": positions.copy(), "right": positions[::-1].copy()}

    def step(
        self, actions: Mapping[str, Numbers]
    ) -> tuple[
        dict[str, Numbers],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Send the commands at once; return with the next sample."""
        positions = self._exchange(np.concatenate([actions[name] for name in CARTS]))
        self._steps += 1
        reward = -abs(float(positions[0] - positions[1]))
        cut = self._steps >= self.max_cycles
        return (
            self._seen(positions),
            dict.fromkeys(CARTS, reward),
            dict.fromkeys(CARTS, False),
            dict.fromkeys(CARTS, cut),
            {name: {} for name in CARTS},
        )

    def _exchange(self, speeds: Numbers) -> Numbers:
        assert self.device is not None, "reset comes first"
        self.device.command(speeds)
        return self.device.sample()

    def close(self) -> None:
        """Called whatever happened before: the device comes to rest."""
        if self.device is not None:
            self.device.close()
            self.device = None


class Twin(Carts):
    """The same carts, simulated."""

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Numbers], dict[str, dict[str, Any]]]:
        self.agents, self._steps = list(CARTS), 0
        self._positions = np.random.default_rng(seed).uniform(-1, 1, 2).astype(np.float32)
        return self._seen(self._positions), {name: {} for name in CARTS}

    def _exchange(self, speeds: Numbers) -> Numbers:
        self._positions = moved(self._positions, speeds)
        return self._positions


def parallel_env() -> Carts:
    """The devices: `env.id=fake_robots:parallel_env`."""
    return Carts()


def simulated() -> Carts:
    """The twin: `env.id=fake_robots:simulated`."""
    return Twin()
