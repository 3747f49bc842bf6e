"""Deployments of real environments and real brains, without a bus: for what reads their logs."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from otc_dist.deployment_log.header import LogHeader, versions
from otc_dist.deployment_log.reader import read_header, read_steps
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout
from otc_dist.transitions import JointStep

FAMILIES = ("hopper-3x1", "predator-prey-3", "cooperative-navigation-4", "navigation", "5m_vs_6m")


def described(env_id: str, steps: int, copies: int, **deployment: object) -> Description:
    algorithm = {"name": "discrete-cql" if env_id == "5m_vs_6m" else "bcq"}
    return Description.build(
        {
            "name": "replayed",
            "env": {"id": env_id, "copies": copies},
            "dataset": {"name": f"{env_id}/random"},
            "algorithm": algorithm,
            "sampling": {"name": "uniform"},
            "deployment": {"transitions": steps * copies, "count": 2, **deployment},
            "engine": {"name": "eager"},
        }
    )


def header_of(description: Description, k: int, **fields: object) -> LogHeader:
    header = LogHeader(
        run="replayed-run",
        deployment=k,
        seed=description.seed,
        description=description.to_toml(),
        description_digest=description.digest(),
        team=registry.team_spec(description.env.id),
        copies=description.env.copies,
    )
    return replace(header, **fields)  # type: ignore[arg-type]


def played(
    path: Path,
    env_id: str,
    steps: int = 120,
    copies: int = 2,
    k: int = 2,
    description: Description | None = None,
) -> Path:
    """The finished log of a deployment with random actions, so many steps if not described."""
    description = description or described(env_id, steps, copies)
    env = registry.make(env_id, copies, description.progress(k))
    rollout = Rollout(env, description.seed, "deployment", k)
    random = np.random.default_rng(0)
    nobody = (False,) * len(env.spec.agents)
    taken = []
    for _ in range(steps):
        actions = []
        for agent, seen in zip(env.spec.agents, rollout.observations, strict=True):
            low, high = np.array(agent.action_low), np.array(agent.action_high)
            drawn = random.uniform(low, high, (copies, agent.action_size))
            if agent.choices:
                available = seen[:, -agent.choices :] * random.random((copies, agent.choices))
                drawn = available.argmax(axis=1)[:, np.newaxis]
            actions.append(drawn.astype(np.float32))
        taken.append(rollout.advance(actions, nobody))
    header = header_of(description, k, versions=versions() | dict(rollout.simulator))
    env.close()
    return logged(path, header, taken)


def logged(
    path: Path,
    header: LogHeader,
    steps: Iterable[JointStep],
    policies: Mapping[str, str] | None = None,
) -> Path:
    """A finished log."""
    writer = LogWriter.create(path, header)
    for step in steps:
        writer.write(step)
    return writer.finish(policies or dict.fromkeys(header.team.names, "0" * 16))


def retold(path: Path, out: Path, *changed: JointStep, **header: object) -> Path:
    """The log again, with some steps and fields of its header exchanged."""
    by_number = {step.step: step for step in changed}
    steps = [by_number.get(step.step, step) for step in read_steps(path)]
    return logged(out, replace(read_header(path), **header), steps)  # type: ignore[arg-type]
