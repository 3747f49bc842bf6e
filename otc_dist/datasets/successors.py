"""Recover successors that a recording lacks, by simulating single steps again."""

from dataclasses import replace

import numpy as np

from otc_dist.datasets.recording import Recording
from otc_dist.envs import robot_specs
from otc_dist.envs.robots import RobotEnv
from otc_dist.spec import TeamSpec
from otc_dist.transitions import Float32

_COPIES = 256  # steps simulated at once
_SAMPLE = 1024  # known successors that the simulation has to reproduce

# Largest acceptable error of a simulated successor's worst coordinate, at the 95th percentile of
# the sample, in standard deviations of that coordinate over the recording.
TOLERANCE = 0.05


def resimulate(recording: Recording, spec: TeamSpec, qpos: Float32, qvel: Float32) -> Recording:
    """Fill unknown successors of a robot's recording from the states before the steps.

    The simulator's version and the solver's warm start differ from the recording's, so the
    successors that are known are simulated as well: only if these agree within `TOLERANCE` are
    the unknown ones filled. Either way a note says what the error was.

    Args:
        qpos: positions before each step, (T, joints).
        qvel: velocities before each step, (T, joints).
    """
    if spec.env_id not in robot_specs.PARTITIONS or not recording.known.any():
        return recording
    unknown, known = np.flatnonzero(~recording.known), np.flatnonzero(recording.known)
    sample = known[np.linspace(0, len(known) - 1, min(_SAMPLE, len(known))).astype(np.int64)]
    rows = np.concatenate((sample, unknown))
    robot = robot_specs.PARTITIONS[spec.env_id][0].name
    simulated = _step(robot, qpos[rows], qvel[rows], recording.actions[rows])
    scale = recording.observations.std(axis=0) + np.float32(1e-6)
    errors = np.abs(simulated[: len(sample)] - recording.next_observations[sample]) / scale
    error = float(np.percentile(errors.max(axis=1), 95))
    measured = f"one-step error of the simulator {error:.2g} standard deviations (95th percentile)"
    if not error <= TOLERANCE:
        return recording.with_notes(f"successors were not simulated: {measured}, above {TOLERANCE}")
    successors = recording.next_observations.copy()
    successors[unknown] = simulated[len(sample) :]
    return replace(
        recording, next_observations=successors, known=np.ones_like(recording.known)
    ).with_notes(f"{len(unknown)} successors were simulated from infos/qpos and qvel: {measured}")


def _step(robot: str, qpos: Float32, qvel: Float32, actions: Float32) -> Float32:
    """Observations (n, O) one step after the states qpos, qvel (n, joints)."""
    env = RobotEnv(robot_specs.single_agent_id(robot), _COPIES)
    joints = qpos.shape[1]
    state = np.zeros((_COPIES, env.spec.state_size))
    observations = []
    for start in range(0, len(qpos), _COPIES):
        rows = slice(start, start + _COPIES)
        count = len(qpos[rows])
        state[:count, 1 : 1 + joints] = qpos[rows]
        state[:count, 1 + joints : 1 + 2 * joints] = qvel[rows]
        env.set_state(state)
        padded = np.zeros((_COPIES, actions.shape[1]), np.float32)
        padded[:count] = actions[rows]
        env.step([padded])
        observations.append(env.observe()[0][:count])
    return np.concatenate(observations)
