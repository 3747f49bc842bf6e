"""Hopper, HalfCheetah and Walker2d over `mujoco.batch`, bit-equal to gymnasium's v4 tasks."""

import os
from collections.abc import Sequence
from importlib import resources

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from otc_dist.envs.base import JointActions, Outcome, at_least_one
from otc_dist.envs.robot_specs import PARTITIONS, Robot, team_spec
from otc_dist.transitions import Bool, Float32, Float64

# Below this number of copies a thread, handing work to the thread costs more than it saves.
_COPIES_PER_THREAD = 32


class RobotEnv:
    """E copies of one robot, a `BatchedEnv`. All agents share one observation and one reward.

    Raises:
        KeyError: unknown `env_id`.
        ValueError: fewer than one copy.
    """

    def __init__(self, env_id: str, copies: int) -> None:
        self.spec = team_spec(env_id)
        self.copies = at_least_one(copies)
        self._robot, self._agents = PARTITIONS[env_id]
        threads = max(1, min(os.cpu_count() or 1, copies // _COPIES_PER_THREAD))
        model = load_model(self._robot)
        self._batch = Batch(model, copies, nthread=threads)
        # Live views of the simulations' states, (E, ...). Derived fields lag one substep behind
        # and are never used.
        self._qpos: Float64 = self._batch.bind("qpos")
        self._qvel: Float64 = self._batch.bind("qvel")
        self._warmstart: Float64 = self._batch.bind("qacc_warmstart")
        self._ctrl: Float64 = self._batch.bind("ctrl")
        # What an agent sees, and what says whether the robot has fallen.
        self._seen: tuple[Float64, Float64] = (self._qpos[:, 1:], self._qvel)
        self._forward: Float64 = self._qpos[:, 0]
        self._healthy = _healthy_range(self._robot)
        self._initial_qpos: Float64 = model.qpos0.copy()
        self._step_seconds = model.opt.timestep * self._robot.frame_skip
        self._cost = np.float32(self._robot.control_cost)
        self._elapsed = np.zeros((copies, 1), np.float64)  # steps
        self._longest = 0  # the largest of them
        self._values: Float64 | None = None  # what is seen, in full precision; None: look again
        self._actions = JointActions(self.spec, copies)
        self._before = np.empty(copies, np.float64)  # forward positions before the step, m

    def reset(self, which: NDArray[np.int64], seeds: NDArray[np.int64]) -> None:
        """See `BatchedEnv.reset`; the same draws as gymnasium's `reset_model`."""
        robot, scale = self._robot, self._robot.reset_scale
        # int32 ids: what the simulator takes without converting them.
        ids = np.asarray(which, np.int32)
        self._batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        for copy, seed in zip(ids, seeds, strict=True):
            rng = np.random.default_rng(int(seed))
            noise = rng.uniform(-scale, scale, robot.joints)
            self._qpos[copy] = self._initial_qpos + noise
            if robot.reset_normal:
                self._qvel[copy] = scale * rng.standard_normal(robot.joints)
            else:
                self._qvel[copy] = rng.uniform(-scale, scale, robot.joints)
        # As gymnasium's set_state: the forward pass leaves a warm start for the solver.
        self._batch.forward(ids)
        self._elapsed[ids] = 0
        self._moved()

    def observe(self) -> tuple[Float32, ...]:
        """See `BatchedEnv.observe`: one array for all agents."""
        robot = self._robot
        observation: Float32 = self._look().astype(np.float32)
        if robot.velocity_clip is not None:
            velocity = observation[:, robot.joints - 1 :]
            np.maximum(velocity, -robot.velocity_clip, out=velocity)
            np.minimum(velocity, robot.velocity_clip, out=velocity)
        return (observation,) * self._agents

    def _look(self) -> Float64:
        if self._values is None:
            self._values = np.concatenate(self._seen, axis=1)
        return self._values

    def _moved(self) -> None:
        """Forget what was derived from the states of before."""
        self._values = None
        self._longest = int(self._elapsed.max())

    def step(self, actions: Sequence[Float32]) -> Outcome:
        """See `BatchedEnv.step`."""
        robot = self._robot
        action = self._actions.clipped(actions)
        self._ctrl[...] = action
        change = self._before
        change[...] = self._forward
        self._batch.step(nstep=robot.frame_skip)
        self._values = None
        self._elapsed += 1
        self._longest += 1
        # The cost is summed in float32 and the rest in float64, as gymnasium does when it is
        # given float32 actions.
        cost = self._cost * np.add.reduce(np.square(action, out=action), axis=1)
        np.subtract(self._forward, change, out=change)
        velocity = np.divide(change, self._step_seconds, out=change)
        reward = (velocity + robot.healthy_reward - cost).astype(np.float32)
        terminated = self._fallen()
        if self._longest < self.spec.max_episode_steps:
            truncated = np.zeros(self.copies, np.bool_)
        else:
            truncated = (self._elapsed[:, 0] >= self.spec.max_episode_steps) & ~terminated
        return Outcome((reward,) * self._agents, terminated, truncated)

    def _fallen(self) -> Bool:
        if self._healthy is None:
            return np.zeros(self.copies, np.bool_)
        low, high = self._healthy
        values = self._look()[:, : len(low)]
        inside = values > low
        inside &= values < high
        # So that what is not a number has fallen.
        healthy: Bool = np.logical_and.reduce(inside, axis=1)
        return ~healthy

    def state(self) -> Float64:
        """See `BatchedEnv.state`: elapsed steps, qpos, qvel, the solver's warm start."""
        parts = (self._elapsed, self._qpos, self._qvel, self._warmstart)
        return np.concatenate(parts, axis=1)

    def set_state(self, state: Float64) -> None:
        """See `BatchedEnv.set_state`. Raises ValueError for another shape."""
        if state.shape != (self.copies, self.spec.state_size):
            raise ValueError(
                f"the state has shape {state.shape}, not {(self.copies, self.spec.state_size)}"
            )
        joints = self._robot.joints
        self._elapsed[...] = state[:, :1]
        self._qpos[...] = state[:, 1 : 1 + joints]
        self._qvel[...] = state[:, 1 + joints : 1 + 2 * joints]
        self._warmstart[...] = state[:, 1 + 2 * joints :]
        self._moved()

    @property
    def versions(self) -> dict[str, str]:
        """See `Versioned.versions`."""
        return {"mujoco": mujoco.__version__}

    def close(self) -> None:
        """Nothing to release: the simulator's memory goes with the object."""


def _healthy_range(robot: Robot) -> tuple[Float64, Float64] | None:
    """Open intervals for the first entries of (qpos[1:], qvel): height, angle, all others."""
    health = robot.health
    if health is None:
        return None
    ranges = [health.height, health.angle]
    if health.limit is not None:
        low, high = health.angle
        ranges[1] = (max(low, -health.limit), min(high, health.limit))
        ranges += [(-health.limit, health.limit)] * (robot.observation_size - len(ranges))
    low_end, high_end = np.array(ranges, np.float64).T
    return low_end, high_end


def load_model(robot: Robot) -> mujoco.MjModel:
    """Compile the robot's MJCF model, which is part of the package."""
    source = resources.files("otc_dist.envs").joinpath("models", robot.model)
    return mujoco.MjModel.from_xml_string(source.read_text(encoding="utf-8"))
