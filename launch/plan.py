"""A run as data: its processes, the bus keys between them, its data, its work, its time.

`--dry-run` prints it and the supervisor starts it: the same object, so they cannot differ.
"""

import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from otc_dist.bus import keys
from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.run_folder import RunFolder
from otc_dist.spec import TeamSpec

from . import forecast
from .board import HOST

# Bytes of one float32 number in a log, of one float64 of state; parameters in a checkpoint.
_CHECKPOINT_BYTES = 2_000_000  # networks of Table 3's sizes, their targets and optimizers


@dataclass(frozen=True)
class Process:
    """One process: what the supervisor starts, and what it says and hears on the bus."""

    name: str
    command: tuple[str, ...]
    publishes: tuple[str, ...]
    hears: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """A resolved run, ready to be started or printed."""

    description: Description
    folder: RunFolder
    spec: TeamSpec
    processes: tuple[Process, ...]

    @property
    def parts(self) -> list[forecast.Part]:
        return forecast.parts(self.description, len(self.spec.agents))

    @property
    def prepare_data(self) -> tuple[str, ...]:
        """The command that makes B_0 if the cache lacks it."""
        dataset = self.description.dataset
        return (
            *(sys.executable, "-m", "otc_dist.datasets", "make", dataset.name),
            *("--transitions", str(dataset.transitions)),
        )

    @property
    def data_is_cached(self) -> bool:
        dataset = self.description.dataset
        return all(
            store.agent_file(dataset.name, agent, dataset.transitions).exists()
            for agent in self.spec.names
        )

    @property
    def disk_bytes(self) -> int:
        """About what the run folder will hold at its largest."""
        numbers = sum(2 * a.observation_size + a.action_size + 1 for a in self.spec.agents)
        step = 4 * numbers + 8 * self.spec.state_size + 100
        count = self.description.deployment.count
        logs = count * self.description.deployment.transitions * step
        checkpoints = (count + 2) * len(self.spec.agents) * _CHECKPOINT_BYTES
        return 2 * logs + checkpoints + 10_000_000

    def lines(self) -> Iterator[str]:
        """The plan for people."""
        d = self.description
        yield f"{d.name}: {d.summary}" if d.summary else d.name
        yield f"run folder   {self.folder.root}"
        yield f"data         {d.dataset.name}, {d.dataset.transitions:,} transitions an agent"
        for agent in self.spec.names:
            path = store.agent_file(d.dataset.name, agent, d.dataset.transitions)
            state = "cached" if path.exists() else "to be made"
            yield f"  {agent:10} {path} ({state})"
        yield f"work         {d.embedding.updates:,} updates of the embedding, for d_e"
        yield f"             {d.offline.updates:,} offline updates to pi_0"
        yield (
            f"             {d.deployment.count} deployments of {d.deployment.transitions:,}"
            f" transitions, {d.deployment.updates:,} updates after each"
        )
        yield f"             {d.evaluation.episodes} greedy episodes after each tuning"
        yield f"engine       {d.engine.name}"
        yield "processes"
        for process in self.processes:
            yield f"  {process.name}: {shlex.join(process.command)}"
            yield from (f"      says   {key}" for key in process.publishes)
            yield from (f"      hears  {key}" for key in process.hears)
        seconds = sum(part.seconds for part in self.parts)
        yield f"time         about {forecast.duration(seconds)}, and what the data take to make"


def make(description: Description, folder: RunFolder, run: str) -> Plan:
    """The plan of a resolved description, `run` being its name on the bus.

    Raises:
        UserError: an unknown environment.
    """
    spec = registry.team_spec(description.env.id)
    host = Process(
        HOST,
        (sys.executable, "-m", "otc_dist.services.env_host", "--run", str(folder.root)),
        (*(keys.observation(run, a) for a in spec.names), keys.status(run, HOST)),
        (*(keys.action(run, a) for a in spec.names), keys.spec(run)),
    )
    learners = tuple(
        Process(
            agent,
            (
                *(sys.executable, "-m", "otc_dist.services.learner"),
                *("--run", str(folder.root), "--agent", agent),
            ),
            (keys.action(run, agent), keys.status(run, agent)),
            (keys.observation(run, agent), keys.history(run, agent)),
        )
        for agent in spec.names
    )
    return Plan(description, folder, spec, (host, *learners))
