"""Random teams and steps, and how steps are compared: bit for bit."""

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from otc_dist.deployment_log.format import FIRST_TIMED_VERSION
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.reader import read_header, read_steps
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.transitions import JointStep


class Recording:
    """A team, its header, and a deployment of random steps."""

    def __init__(
        self, sizes: tuple[tuple[int, int], ...], copies: int, steps: int, state_size: int = 5
    ) -> None:
        self.team = TeamSpec(
            "test-team",
            tuple(
                AgentSpec(f"agent_{i}", size, (-1.0,) * actions, (1.0,) * actions)
                for i, (size, actions) in enumerate(sizes)
            ),
            state_size,
            1000,
        )
        self.header = LogHeader(
            run="a-run", deployment=3, seed=7, description='name = "téam"\n',
            description_digest="0123456789abcdef", team=self.team, copies=copies,
        )  # fmt: skip
        self.rng = np.random.default_rng(0)
        self.seeds = self.rng.integers(0, 2**62, copies)
        self.steps = [self.make(t) for t in range(steps)]

    def make(self, t: int) -> JointStep:
        """Any bits are values: NaN, infinities, negative zero and subnormal numbers occur."""
        rng, copies, agents = self.rng, self.header.copies, self.team.agents

        def floats(*shape: int) -> np.ndarray:
            return np.frombuffer(rng.bytes(4 * int(np.prod(shape))), "<f4").reshape(shape)

        ends = rng.random(copies) < 0.2
        timeouts = ~ends & (rng.random(copies) < 0.2)
        step = JointStep(
            step=t,
            observations=tuple(floats(copies, agent.observation_size) for agent in agents),
            actions=tuple(floats(copies, agent.action_size) for agent in agents),
            rewards=tuple(rng.standard_normal(copies).astype(np.float32) for _ in agents),
            next_observations=tuple(floats(copies, agent.observation_size) for agent in agents),
            terminated=ends,
            truncated=timeouts,
            exploring=tuple(bool(rng.integers(2)) for _ in agents),
            episode_seeds=self.seeds.copy(),
            state=np.frombuffer(rng.bytes(8 * copies * self.team.state_size), "<f8").reshape(
                copies, -1 if self.team.state_size else 0
            ),
        )
        self.seeds = np.where(ends | timeouts, rng.integers(0, 2**62, copies), self.seeds)
        return step

    def by_a_clock(self) -> "Recording":
        """As if it had gone by a clock: steps say which deadlines were missed."""
        self.header = replace(self.header, format_version=FIRST_TIMED_VERSION)
        agents = len(self.team.agents)
        self.steps = [
            replace(step, held=tuple(map(bool, self.rng.integers(2, size=agents))), late=i % 3 == 0)
            for i, step in enumerate(self.steps)
        ]
        return self

    def write(self, path: Path, stop: int | None = None) -> LogWriter:
        """An unfinished log of the steps before `stop`."""
        writer = LogWriter.create(path, self.header)
        for step in self.steps[:stop]:
            writer.write(step)
        return writer

    def finish(self, path: Path) -> Path:
        return self.write(path).finish({name: f"digest of {name}" for name in self.team.names})


def again(partial: Path, **header: object) -> Path:
    """An unfinished log once more, at its place, with fields of its header exchanged."""
    found, steps = read_header(partial), list(read_steps(partial))
    partial.unlink()
    writer = LogWriter.create(partial.with_suffix(""), replace(found, **header))  # type: ignore[arg-type]
    for step in steps:
        writer.write(step)
    writer.close()
    return partial


@pytest.fixture(scope="session")
def recording_of() -> Callable[..., Recording]:
    return Recording


@pytest.fixture
def recording() -> Callable[..., Recording]:
    return Recording


@pytest.fixture
def small() -> Recording:
    """Two unlike agents, two copies, a few steps."""
    return Recording(((3, 1), (2, 2)), copies=2, steps=12)


@pytest.fixture
def same() -> Callable[[JointStep, JointStep], bool]:
    """Equal to the bit, in type and in shape."""
    return same_step


def bits(value: object) -> object:
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, value.tobytes())
    if isinstance(value, tuple):
        return tuple(bits(item) for item in value)
    return (type(value), value)


def same_step(a: JointStep, b: JointStep) -> bool:
    return all(bits(getattr(a, f.name)) == bits(getattr(b, f.name)) for f in fields(JointStep))
