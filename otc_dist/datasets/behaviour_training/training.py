"""Train the behaviour policies that ship with the package.

PPO trains until the stochastic policy is at the task's medium level. Snapshots, equally spaced in
steps from the untrained policy to that one, are kept with a card that states their true returns;
of the skirmish, whose data the medium policy alone makes, only that one.

Deterministic: the same seed on the same machine and library versions gives the same bytes.
"""

import hashlib
import json
import time
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from safetensors.numpy import save

from otc_dist.datasets.behaviour import Snapshot, policy_of
from otc_dist.datasets.behaviour_training.ppo import Settings, Trainer
from otc_dist.datasets.behaviour_training.ppo_models import Tensors
from otc_dist.envs import registry
from otc_dist.envs.base import Contest
from otc_dist.envs.robot_specs import single_agent_id
from otc_dist.randomness import derive_seed, stream
from otc_dist.system.versions import of_packages
from otc_dist.transitions import Float64

CANDIDATES = 8  # the last iterations, among which the medium policy is chosen


@dataclass(frozen=True)
class Task:
    """What to train on, and how far."""

    env_id: str
    medium: float  # level of the medium policy: its mean return, or percent of episodes won
    settings: Settings = field(default_factory=Settings)
    snapshots: int = 10
    maximum_steps: int = 1_200_000
    evaluation_episodes: int = 50
    # Share of the level at which training episodes, which lag, call for an evaluation.
    promising: float = 0.9


# Of robots, the mean returns of D4RL's `-medium-v2` data (Fu et al. 2020). An initial deviation of
# 0.5 (Andrychowicz et al. 2021) teaches HalfCheetah several times as fast as one of 1, since fewer
# actions are lost at their bounds, but Hopper three times as slowly.
# The skirmish's medium policy wins half of its battles.
TASKS = {
    "hopper": Task(single_agent_id("hopper"), 1422.0),
    "halfcheetah": Task(single_agent_id("halfcheetah"), 4770.0, Settings(initial_std=0.5)),
    "walker2d": Task(single_agent_id("walker2d"), 2852.0),
    "5m_vs_6m": Task(
        "5m_vs_6m",
        50.0,
        Settings(
            copies=64,
            horizon=64,
            epochs=5,
            minibatch=2560,
            learning_rate=5e-4,
            entropy_weight=0.01,
        ),
        snapshots=1,
        maximum_steps=4_000_000,
        evaluation_episodes=500,
        promising=1.0,
    ),
}

History = list[tuple[int, Tensors]]  # (environment steps, policy) of every iteration


@dataclass(frozen=True)
class Scores:
    """What a stochastic policy scores, by episode."""

    returns: Float64
    success: Float64 | None  # 100 where the episode was won, else 0

    @property
    def level(self) -> float:
        """What a task's `medium` is compared with."""
        return float((self.returns if self.success is None else self.success).mean())


def evaluate(name: str, tensors: Tensors, seed: int, purpose: str) -> Scores:
    """True scores of `evaluation_episodes` episodes of the stochastic policy."""
    copies = TASKS[name].evaluation_episodes
    env, policy = registry.make(TASKS[name].env_id, copies), policy_of(tensors)
    agents = len(env.spec.agents)
    random = stream(seed, name, purpose, "noise")
    seeds = [derive_seed(seed, name, purpose, copy) for copy in range(copies)]
    env.reset(np.arange(copies), np.array(seeds, np.int64))
    returns, playing = np.zeros(copies), np.ones(copies, np.bool_)
    success = np.zeros(copies) if isinstance(env, Contest) else None
    while playing.any():
        noise = policy.noise(random, agents * copies)
        actions = policy.act(np.concatenate(env.observe()), noise)
        outcome = env.step(np.split(actions, agents))
        returns += np.mean(outcome.rewards, axis=0, dtype=np.float64) * playing
        if success is not None and isinstance(env, Contest):
            success += 100.0 * env.success * playing
        playing &= ~(outcome.terminated | outcome.truncated)
    return Scores(returns, success)


def train(name: str, seed: int) -> History:
    """Train to the medium level; returns (steps, tensors) of every iteration up to it.

    Where the level is not reached within the task's `maximum_steps`, one of the last policies is
    the medium one; its card says what it scores.
    """
    task = TASKS[name]
    env = registry.make(task.env_id, task.settings.copies)
    trainer = Trainer(name, env, seed, task.settings)
    history = [(0, trainer.snapshot())]
    started = time.monotonic()
    while trainer.steps < task.maximum_steps:
        trainer.update(trainer.collect())
        history.append((trainer.steps, trainer.snapshot()))
        recent = trainer.level()
        if len(history) % 10 == 1:
            seconds = time.monotonic() - started
            print(
                f"{name} {trainer.steps:>8} steps {seconds:6.0f} s level {recent:8.1f}",
                flush=True,
            )
        # Episodes of training lag the policy: the evaluation decides.
        if recent >= task.promising * task.medium:
            exact = evaluate(name, history[-1][1], seed, "stopping").level
            print(f"{name} {trainer.steps:>8} steps evaluated {exact:8.1f}", flush=True)
            if exact >= 0.98 * task.medium:
                break
    return _up_to_medium(name, seed, history)


def _up_to_medium(name: str, seed: int, history: History) -> History:
    """Cut the history after the one of its last policies that is nearest to the medium level.

    Policies differ by more between iterations than the level asks for, and the one that ended
    training was picked for a high score.
    """

    def distance(index: int) -> float:
        score = evaluate(name, history[index][1], seed, "choosing").level
        print(f"{name} {history[index][0]:>8} steps candidate {score:8.1f}", flush=True)
        return abs(score - TASKS[name].medium)

    medium = min(range(max(0, len(history) - CANDIDATES), len(history)), key=distance)
    return history[: medium + 1]


def write(name: str, seed: int, history: History, out: Path) -> None:
    """Write the chosen snapshots and their card to `out`/<name>/."""
    task, folder = TASKS[name], out / name
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("step_*.safetensors"):
        old.unlink()
    rows = []
    spaced = np.linspace(0, len(history) - 1, task.snapshots).round().astype(int)
    spaced[-1] = len(history) - 1
    for index in np.unique(spaced):
        steps, tensors = history[index]
        # Other episodes than those that chose where to stop: they would flatter the last policy.
        scores, data = evaluate(name, tensors, seed, "card"), save(tensors)
        file = f"step_{steps:07}.safetensors"
        (folder / file).write_bytes(data)
        snapshot = Snapshot(
            file,
            steps,
            round(float(scores.returns.mean()), 1),
            round(float(scores.returns.std()), 1),
            len(scores.returns),
            hashlib.sha256(data).hexdigest(),
            None if scores.success is None else round(float(scores.success.mean()), 1),
        )
        rows.append({key: value for key, value in asdict(snapshot).items() if value is not None})
        print(f"{name} {snapshot}", flush=True)
    card = {
        "task": name,
        "environment": task.env_id,
        "algorithm": "PPO",
        "settings": asdict(task.settings),
        "medium": rows[-1]["file"],
        "medium_level": task.medium,
        "command": f"python -m otc_dist.datasets.behaviour_training {name} --seed {seed}",
        "seed": seed,
        "versions": of_packages("mujoco", "numpy", "torch"),
        "date": datetime.now(UTC).date().isoformat(),
        "snapshots": rows,
    }
    (folder / "card.json").write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
