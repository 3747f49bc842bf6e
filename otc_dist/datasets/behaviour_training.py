"""Train the behaviour policies that ship with the package: `... behaviour_training hopper`.

PPO trains until the stochastic policy scores what D4RL's medium data score on average. Ten
snapshots, equally spaced in steps from the untrained policy to that one, are kept with a card
that states their true returns.

Deterministic: the same seed on the same machine and library versions gives the same bytes.
"""

import argparse
import hashlib
import json
import time
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

import mujoco
import numpy as np
import torch
from safetensors.numpy import save

from otc_dist.datasets.behaviour import BehaviourPolicy, Snapshot
from otc_dist.datasets.ppo import Settings, Tensors, Trainer
from otc_dist.envs.robot_specs import single_agent_id
from otc_dist.envs.robots import RobotEnv
from otc_dist.errors import run_main
from otc_dist.randomness import derive_seed, stream
from otc_dist.transitions import Float64

# Mean returns of D4RL's `-medium-v2` data (Fu et al. 2020).
MEDIUM_RETURN = {"hopper": 1422.0, "halfcheetah": 4770.0, "walker2d": 2852.0}
# An initial deviation of 0.5 (Andrychowicz et al. 2021) teaches HalfCheetah several times as fast
# as one of 1, since fewer actions are lost at their bounds, but Hopper three times as slowly.
SETTINGS = {
    "hopper": Settings(),
    "halfcheetah": Settings(initial_std=0.5),
    "walker2d": Settings(),
}
SNAPSHOTS = 10
EVALUATION_EPISODES = 50
CANDIDATES = 8  # the last iterations, among which the medium policy is chosen
MAX_STEPS = 1_200_000

History = list[tuple[int, Tensors]]  # (environment steps, policy) of every iteration


def evaluate(robot: str, tensors: Tensors, seed: int, purpose: str) -> Float64:
    """True returns of `EVALUATION_EPISODES` episodes of the stochastic policy."""
    env = RobotEnv(single_agent_id(robot), EVALUATION_EPISODES)
    policy, size = BehaviourPolicy(tensors), env.spec.agents[0].action_size
    noise = stream(seed, robot, purpose, "noise")
    seeds = [derive_seed(seed, robot, purpose, copy) for copy in range(env.copies)]
    env.reset(np.arange(env.copies), np.array(seeds, np.int64))
    returns, playing = np.zeros(env.copies), np.ones(env.copies, np.bool_)
    while playing.any():
        draws = noise.standard_normal((env.copies, size), np.float32)
        outcome = env.step([policy.act(env.observe()[0], draws)])
        returns += outcome.rewards[0] * playing
        playing &= ~(outcome.terminated | outcome.truncated)
    return returns


def train(robot: str, seed: int, settings: Settings) -> History:
    """Train to the medium level; returns (steps, tensors) of every iteration up to it.

    Where the level is not reached within `MAX_STEPS`, one of the last policies is the medium one;
    its card says what it scores.
    """
    trainer, target = Trainer(robot, seed, settings), MEDIUM_RETURN[robot]
    history = [(0, trainer.snapshot())]
    started = time.monotonic()
    while trainer.steps < MAX_STEPS:
        trainer.update(trainer.collect())
        history.append((trainer.steps, trainer.snapshot()))
        recent = float(np.mean(trainer.episode_returns[-settings.copies :] or [0.0]))
        if len(history) % 10 == 1:
            seconds = time.monotonic() - started
            print(
                f"{robot} {trainer.steps:>8} steps {seconds:6.0f} s return {recent:8.1f}",
                flush=True,
            )
        # Episodes of training lag behind the policy: the evaluation decides.
        if recent >= 0.9 * target:
            exact = float(evaluate(robot, history[-1][1], seed, "stopping").mean())
            print(f"{robot} {trainer.steps:>8} steps evaluated {exact:8.1f}", flush=True)
            if exact >= 0.98 * target:
                break
    return _up_to_medium(robot, seed, history)


def _up_to_medium(robot: str, seed: int, history: History) -> History:
    """Cut the history behind the one of its last policies that is nearest to the medium level.

    Policies differ by more between iterations than the level asks for, and the one that ended
    training was picked for a high score.
    """

    def distance(index: int) -> float:
        score = float(evaluate(robot, history[index][1], seed, "choosing").mean())
        print(f"{robot} {history[index][0]:>8} steps candidate {score:8.1f}", flush=True)
        return abs(score - MEDIUM_RETURN[robot])

    medium = min(range(max(0, len(history) - CANDIDATES), len(history)), key=distance)
    return history[: medium + 1]


def write(
    robot: str,
    seed: int,
    settings: Settings,
    history: History,
    out: Path,
) -> None:
    """Write the chosen snapshots and their card to `out`/<robot>/."""
    folder = out / robot
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("step_*.safetensors"):
        old.unlink()
    rows = []
    for index in np.unique(np.linspace(0, len(history) - 1, SNAPSHOTS).round().astype(int)):
        steps, tensors = history[index]
        # Other episodes than those that chose where to stop: they would flatter the last policy.
        returns, data = evaluate(robot, tensors, seed, "card"), save(tensors)
        name = f"step_{steps:07}.safetensors"
        (folder / name).write_bytes(data)
        mean, std = round(float(returns.mean()), 1), round(float(returns.std()), 1)
        digest = hashlib.sha256(data).hexdigest()
        rows.append(asdict(Snapshot(name, steps, mean, std, len(returns), digest)))
        print(f"{robot} {name} return {mean} +- {std}", flush=True)
    card = {
        "robot": robot,
        "environment": single_agent_id(robot),
        "algorithm": "PPO",
        "settings": asdict(settings),
        "medium": rows[-1]["file"],
        "medium_return_of_d4rl": MEDIUM_RETURN[robot],
        "command": f"python -m otc_dist.datasets.behaviour_training {robot} --seed {seed}",
        "seed": seed,
        "versions": {
            "mujoco": mujoco.__version__,
            "numpy": np.__version__,
            "torch": torch.__version__,
        },
        "date": datetime.now(UTC).date().isoformat(),
        "snapshots": rows,
    }
    (folder / "card.json").write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")


def main(argv: list[str]) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m otc_dist.datasets.behaviour_training",
        description="Train a robot's behaviour policies with PPO (some minutes, one thread).",
    )
    parser.add_argument("robot", choices=sorted(MEDIUM_RETURN))
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(__file__).parent / "snapshots",
        help="folder of the snapshots (default: the package's own)",
    )
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    settings = SETTINGS[options.robot]
    history = train(options.robot, options.seed, settings)
    write(options.robot, options.seed, settings, history, options.out)
    return 0


if __name__ == "__main__":
    run_main(main)
