"""How much of `mujoco.batch`'s own speed is left in the env host, with the learners at rest?

    python benchmarks/env_host.py [--env hopper-3x1] [--rounds 15]

Both sides replay the same deployment of the shipped medium policy, in alternating rounds: the
env host's work for a step (rollout, with resets, and the log written ahead) against
`mujoco.batch` alone doing the same simulation steps and resets.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from otc_dist.datasets.behaviour import load_card, load_policy
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs import registry
from otc_dist.envs.robot_specs import PARTITIONS
from otc_dist.envs.robots import load_model
from otc_dist.envs.rollout import Rollout
from otc_dist.terminal.errors import run_main
from otc_dist.transitions import JointStep

COPIES = (1, 4, 8, 16)
STEPS = 1000


def record(env_id: str, copies: int) -> list[JointStep]:
    """A deployment by the medium policy, which both sides replay."""
    robot, _ = PARTITIONS[env_id]
    policy = load_policy(robot.name, load_card(robot.name).medium)
    rollout = Rollout(registry.make(env_id, copies), 0, "deployment", 1)
    agents = registry.team_spec(env_id).agents
    cuts = np.cumsum([agent.action_size for agent in agents])[:-1]
    noise = np.random.default_rng(0)
    steps = []
    for _ in range(STEPS):
        size = (copies, sum(agent.action_size for agent in agents))
        joint = policy.act(rollout.observations[0], noise.standard_normal(size, np.float32))
        actions = [np.ascontiguousarray(part) for part in np.split(joint, cuts, axis=1)]
        steps.append(rollout.advance(actions, (False,) * len(agents)))
    return steps


def host(env_id: str, copies: int, steps: list[JointStep], folder: Path, number: int) -> float:
    """Seconds a step of the env host's work, the learners' answers given."""
    env = registry.make(env_id, copies)
    header = LogHeader("benchmark", 1, 0, "", "", env.spec, copies)
    log = LogWriter.create(folder / f"{copies}_{number}.mcap", header)
    rollout = Rollout(env, 0, "deployment", 1)
    start = time.perf_counter()
    for step in steps:
        log.write(rollout.advance(step.actions, step.exploring))
    seconds = time.perf_counter() - start
    log.close()
    return seconds / len(steps)


def simulator(env_id: str, copies: int, steps: list[JointStep]) -> float:
    """Seconds a step of `mujoco.batch` alone, with the same actions and resets."""
    robot, _ = PARTITIONS[env_id]
    batch = Batch(load_model(robot), copies, nthread=1)
    qpos, qvel, ctrl = (batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
    first = steps[0].state
    joints = robot.joints
    controls = [np.clip(np.concatenate(step.actions, axis=1), -1, 1) for step in steps]
    states: list[NDArray[np.float64]] = [step.state for step in steps]
    ended = [np.flatnonzero(step.terminated | step.truncated).astype(np.int32) for step in steps]
    batch.reset(np.arange(copies, dtype=np.int32))
    qpos[...], qvel[...] = first[:, 1 : 1 + joints], first[:, 1 + joints : 1 + 2 * joints]
    start = time.perf_counter()
    for index, control in enumerate(controls):
        ctrl[...] = control
        batch.step(nstep=robot.frame_skip)
        which = ended[index]
        if len(which) and index + 1 < len(states):
            batch.reset(which)
            state = states[index + 1][which]
            qpos[which] = state[:, 1 : 1 + joints]
            qvel[which] = state[:, 1 + joints : 1 + 2 * joints]
    return (time.perf_counter() - start) / len(steps)


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--env", default="hopper-3x1", help="environment (default %(default)s)")
    parser.add_argument("--rounds", type=int, default=15, help="alternating rounds")
    arguments = parser.parse_args(argv)
    print(f"{arguments.env}, medians of {arguments.rounds} alternating rounds of {STEPS} steps")
    print("copies  mujoco.batch alone  env host  share of mujoco.batch's speed")
    for copies in COPIES:
        steps = record(arguments.env, copies)
        with tempfile.TemporaryDirectory() as folder:
            pairs = [
                (
                    simulator(arguments.env, copies, steps),
                    host(arguments.env, copies, steps, Path(folder), number),
                )
                for number in range(arguments.rounds)
            ]
        alone, hosted = np.median(np.array(pairs), axis=0) * 1e6
        share = np.median([a / b for a, b in pairs])
        print(f"{copies:6d}  {alone:15.0f} us  {hosted:5.0f} us  {share:8.0%}", flush=True)
    return 0


if __name__ == "__main__":
    run_main(main)
