"""The robots' offline data, played by the behaviour policies that come with the package.

- `random`: uniform actions.
- `medium`: stochastic samples of the medium snapshot.
- `medium-replay`: a labelled mixture of the snapshots from the untrained policy to the medium
  one, in training order and with equal shares. It stands in for a replay buffer of training.

The partition into agents only splits the action vector: all partitions of one robot get the same
data.
"""

from collections.abc import Sequence
from importlib.metadata import version

import numpy as np

from otc_dist.datasets.behaviour import BehaviourPolicy, Snapshot, load_card, load_policy
from otc_dist.datasets.source import ActionSlices, Behaviour, Uniform
from otc_dist.envs.robot_specs import PARTITIONS, team_spec
from otc_dist.spec import TeamSpec
from otc_dist.transitions import Float32

LEVELS = ("random", "medium", "medium-replay")

_UNIFORM = "uniform"
_ONE_POLICY = 1_000_000
# The sizes of D4RL's `-v2` data, in transitions. Their medium-replay sizes: Fu et al. 2020.
_REPLAY = {"hopper": 402_000, "halfcheetah": 202_000, "walker2d": 302_000}


class RobotSource:
    """The `Source` of all robot environments."""

    packages = ("mujoco",)

    def offers(self, env_id: str) -> bool:
        return env_id in PARTITIONS

    def levels(self, env_id: str) -> tuple[str, ...]:
        return LEVELS

    def usual_size(self, env_id: str, level: str) -> int:
        """The size of D4RL's data set of that robot and level."""
        return _REPLAY[self.seed_name(env_id)] if level == "medium-replay" else _ONE_POLICY

    def policies(self, env_id: str, level: str) -> tuple[str, ...]:
        """`uniform`, or the stems of snapshots' files."""
        if level == "random":
            return (_UNIFORM,)
        return tuple(_stem(snapshot) for snapshot in self._snapshots(env_id, level))

    def behaviour(self, env_id: str, policy: str) -> Behaviour:
        team, robot = team_spec(env_id), self.seed_name(env_id)
        if policy == _UNIFORM:
            return Uniform(team)
        snapshots = load_card(robot).snapshots
        snapshot = next(snapshot for snapshot in snapshots if _stem(snapshot) == policy)
        return _Joint(load_policy(robot, snapshot), team)

    def seed_name(self, env_id: str) -> str:
        """The robot's name, whatever its partition."""
        return PARTITIONS[env_id][0].name

    def recipe(self, env_id: str, level: str) -> dict[str, str]:
        recipe = {"mujoco": version("mujoco")}
        if level != "random":
            for snapshot in self._snapshots(env_id, level):
                recipe[f"policy {_stem(snapshot)}"] = snapshot.sha256
        return recipe

    def _snapshots(self, env_id: str, level: str) -> tuple[Snapshot, ...]:
        snapshots = load_card(self.seed_name(env_id)).snapshots
        return snapshots if level == "medium-replay" else snapshots[-1:]


class _Joint:
    """A policy that moves the whole robot, and whose action is split among the agents."""

    def __init__(self, policy: BehaviourPolicy, team: TeamSpec) -> None:
        self._policy, self._slices = policy, ActionSlices(team)

    def noise(self, random: np.random.Generator, steps: int) -> Float32:
        return random.standard_normal((steps, self._slices.total), np.float32)

    def act(self, observations: Sequence[Float32], noise: Float32) -> Sequence[Float32]:
        return self._slices.split(self._policy.act(observations[0], noise))


def _stem(snapshot: Snapshot) -> str:
    return snapshot.file.removesuffix(".safetensors")
