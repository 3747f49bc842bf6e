"""The example's carts with a record of what they were really told, and data to learn from.

`told` of the environment CARTS_TOLD names a file, to which each command of both carts is appended,
"stop" whenever they come to rest, and "on" when they are switched on; when the command of number
CARTS_MARK (of this process) is told, the file CARTS_TOLD.MARK appears; CARTS_TOLD.stop appears when
they first come to rest. CARTS_PERIOD is the device's period, seconds.
"""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import fake_robots
import numpy as np
import pytest
from fake_robots import Carts, Numbers

from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.writing import Provenance, locked, publish, versions
from otc_dist.description import user_code
from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout

ENV = "carts:parallel_env"


class Told(Carts):
    """The carts, which put down what they are told."""

    count = 0

    def _tell(self, what: object) -> None:
        with Path(os.environ["CARTS_TOLD"]).open("a") as file:
            file.write(json.dumps(what) + "\n")

    def _exchange(self, speeds: Numbers) -> Numbers:
        self._tell(speeds.tolist())
        self.count += 1
        if str(self.count) == os.environ.get("CARTS_MARK"):
            Path(f"{os.environ['CARTS_TOLD']}.{self.count}").touch()
        return super()._exchange(speeds)

    def close(self) -> None:
        if self.device is not None:
            self._tell("stop")
            Path(f"{os.environ['CARTS_TOLD']}.stop").touch()
        super().close()


def parallel_env() -> Told:
    fake_robots.PERIOD = float(os.environ.get("CARTS_PERIOD", fake_robots.PERIOD))
    return Told()


@contextmanager
def found() -> Iterator[None]:
    """They can be found, by this process and by those that it starts, and there are data of them:
    1200 transitions of their twin, called "recorded", as if they had been imported.
    """
    tests = Path(__file__).parent
    paths = [str(tests.parent / "examples"), str(tests)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(paths))
        for path in paths:
            patch.syspath_prepend(path)
        patch.setattr(user_code, "_allowed", {ENV, "fake_robots:simulated"})
        _record(DatasetName(ENV, "recorded"), 1200)
        yield


def _record(name: DatasetName, transitions: int) -> None:
    random, nobody = np.random.default_rng(0), (False, False)
    rollout = Rollout(registry.make("fake_robots:simulated", 1), 0, "deployment", 1)
    steps = [
        rollout.advance(list(random.uniform(-1, 1, (2, 1, 1)).astype(np.float32)), nobody)
        for _ in range(transitions)
    ]
    made = Provenance("a test", {}, versions(), np.zeros(1), 0)
    with locked(name):
        publish(name, JointTransitions.of_steps(steps), made)
