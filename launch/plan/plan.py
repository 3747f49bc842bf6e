"""A run as data: its processes, the bus keys between them, its data, its work, its time.

`--dry-run` prints it and the supervisor starts it: the same object, so they cannot differ.
"""

import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from otc_dist.bus.keys import HOST, Keys, Uses
from otc_dist.datasets import store
from otc_dist.description import DeploymentSection, Description
from otc_dist.description.distances import facts_of
from otc_dist.envs import registry
from otc_dist.run.exploration import Schedule
from otc_dist.run.folder import RunFolder
from otc_dist.spec import TeamSpec
from otc_dist.terminal.amounts import duration

from . import forecast
from .beside import NOTHING, Beside
from .deadline import within
from .placement import Placement

# Of bus.answer_deadline: who stands still so long is started again, before the others give it up.
_STUCK = 0.75
_ASKING = 60.0  # seconds that a user's environment may take at least to describe its agents
# Bytes of one float32 number in a log, of one float64 of state; parameters in a checkpoint.
_CHECKPOINT_BYTES = 2_000_000  # networks of Table 3's sizes, their targets and optimizers


@dataclass(frozen=True)
class Process:
    """One process: what the supervisor starts, and what it does on the bus."""

    name: str
    command: tuple[str, ...]
    uses: Uses


@dataclass(frozen=True)
class Plan:
    """A resolved run, ready to be started or printed."""

    description: Description
    folder: RunFolder
    spec: TeamSpec
    processes: tuple[Process, ...]  # those of this machine
    placement: Placement
    beside: Beside = NOTHING

    @property
    def parts(self) -> list[forecast.Part]:
        return forecast.parts(self.description, self.spec, len(self.learners))

    @property
    def patience(self) -> float:
        """Seconds that a process may stand still when it is its turn."""
        return _STUCK * self.description.bus.answer_deadline

    @property
    def learners(self) -> tuple[str, ...]:
        """The agents that learn on this machine."""
        return tuple(process.name for process in self.processes if process.name != HOST)

    @property
    def watched(self) -> tuple[str, ...]:
        """The agents whose statuses are looked at: who learns here, or all where the host is."""
        return self.spec.names if self.placement.role != "learner" else self.learners

    @property
    def data_folder(self) -> Path | None:
        """Where B_0 and its card lie; None where no agent learns."""
        if not self.learners:
            return None
        return self._data_file(self.learners[0]).parent

    @property
    def preparations(self) -> dict[str, tuple[str, ...]]:
        """What is done before the processes start, each by a command: B_0, and compiled code."""
        if self.placement.role == "host":
            return {}
        dataset, module = self.description.dataset, (sys.executable, "-m")
        make = (*module, "otc_dist.datasets", "make", dataset.name)
        own = (self.placement.agent,) if self.placement.agent else ()
        steps: dict[str, tuple[str, ...]] = {
            "data": (
                *(*make, "--transitions", str(dataset.transitions)),
                *(("--agent", *own) if own else ()),
            )
        }
        if self.description.engine.name != "eager":
            steps["compile"] = (*module, "otc_dist.launch.run.compile", str(self.folder.root), *own)
        return steps

    @property
    def conclusions(self) -> dict[str, tuple[str, ...]]:
        """What is done when the processes have ended, each by a command: the report."""
        if self.placement.role == "learner":
            return {}
        return {"report": (sys.executable, "-m", "otc_dist.report", str(self.folder.root))}

    @property
    def disk_bytes(self) -> int:
        """About what the run folder will hold at its largest."""
        numbers = sum(2 * a.observation_size + a.action_size + 1 for a in self.spec.agents)
        step = 4 * numbers + 8 * self.spec.state_size + 100
        count = self.description.deployment.count
        rounds = Schedule.of(self.description, len(self.spec.agents)).rounds
        logs = (
            self.description.deployment.total
            * rounds
            * self.description.deployment.transitions
            * step
        )
        checkpoints = (count + 2) * len(self.spec.agents) * _CHECKPOINT_BYTES
        return 2 * logs + checkpoints + 10_000_000

    def lines(self) -> Iterator[str]:
        """The plan for people."""
        d = self.description
        yield f"{d.name}: {d.heading}"
        yield f"run folder   {self.folder.root}"
        yield f"data         {d.dataset.name}, {d.dataset.transitions:,} transitions per agent"
        for agent in self.learners:
            path = self._data_file(agent)
            state = "cached" if path.exists() else "to be made"
            yield f"  {agent:10} {path} ({state})"
        yield from (f"environment  {remark}" for remark in registry.remarks(d.env.id))
        begins = f"{d.offline.updates:,} offline updates to pi_0"
        yield f"work         {'pi_0 of another run' if d.offline.policies else begins}"
        if forecast.fit(d).seconds and (compared := d.sampling.compared):
            facts = facts_of(compared)
            yield f"             and what {facts.title} fits to B_0 ({facts.fits})"
        rounds = Schedule.of(d, len(self.spec.agents)).rounds
        cost = f" an agent, who explore in turn: x {rounds}" if rounds > 1 else ""
        yield (
            f"             {d.deployment.count} deployments of {d.deployment.transitions:,}"
            f" transitions{cost}, {d.deployment.updates:,} updates after each"
            + (", of one agent in turn" if d.deployment.turns else "")
        )
        if d.deployment.confirm:
            yield "             one deployment more, of the last tuned policy"
        yield from (f"             {line}" for line in _conditions(d.deployment))
        yield f"             {d.evaluation.episodes} greedy episodes after each tuning"
        own = ", with matrix products of our own" if d.engine.products == "own" else ""
        yield f"engine       {d.engine.name}{own}"
        yield f"disk         about {self.disk_bytes / 1e6:,.0f} MB at most"
        if self.preparations:
            yield "first"
        for name, command in self.preparations.items():
            yield f"  {name}: {shlex.join(command)}"
        yield "processes"
        for process in self.processes:
            yield f"  {process.name}: {shlex.join(process.command)}"
            for does, keys in vars(process.uses).items():
                yield from (f"      {does:9} {key}" for key in keys)
        for companion in self.beside.companions(self.folder.root):
            yield f"beside       {shlex.join(companion.command)}"
        seconds = sum(part.seconds for part in self.parts)
        making = "" if self._cached else ", and what the data take to make"
        yield f"time         about {duration(seconds)}{making}"

    @property
    def _cached(self) -> bool:
        """Whether all data files are there that the learners of this machine need."""
        return all(self._data_file(agent).exists() for agent in self.learners)

    def _data_file(self, agent: str) -> Path:
        dataset = self.description.dataset
        return store.agent_file(dataset.name, agent, dataset.transitions)


def _conditions(deployment: DeploymentSection) -> Iterator[str]:
    """What is kept, and what a deployment depends on, in words."""
    kept = "the best deployed policy" if deployment.keep == "best" else "the last tuned policy"
    yield f"{kept} is recommended" + (", and tuning continues from it" if deployment.revert else "")
    if deployment.floor is not None:
        yield f"no deployment follows one that measures less than {deployment.floor:g}"
    if deployment.approve:
        yield "a person approves each deployment"
    if deployment.rate_hz is not None:
        yield f"{deployment.rate_hz:g} steps a second: who answers later repeats its action"
    if deployment.reset_by_hand:
        yield "a person resets the devices before each episode"


def team_of(description: Description) -> TeamSpec:
    """The team of a description, of a user's environment as well.

    Raises:
        UserError: an unknown environment, or a user's that does not answer in time.
    """
    patience = max(_ASKING, description.bus.answer_deadline)
    with within(patience, f"asking {description.env.id} for its agents"):
        return registry.team_spec(description.env.id)


def make(
    description: Description,
    folder: RunFolder,
    run: str,
    placement: Placement,
    beside: Beside = NOTHING,
) -> Plan:
    """The plan of a resolved description, `run` being its name on the bus.

    Raises:
        UserError: an unknown environment, or one of which nothing is to be seen as is asked for.
    """
    spec = team_of(description)
    beside.check_team(spec)
    keys = Keys(run, description.shared_digest())

    def process(name: str) -> Process:
        host = name == HOST
        module = "otc_dist.services.env_host" if host else "otc_dist.services.learner"
        whose = () if host else ("--agent", name)
        command = (sys.executable, "-m", module, "--run", str(folder.root), *whose)
        uses = keys.host_uses(spec.names) if host else keys.learner_uses(name)
        watched = beside.host_flags() if host else ()
        return Process(name, (*command, *placement.flags(host), *watched), uses)

    processes = tuple(map(process, placement.processes(spec)))
    return Plan(description, folder, spec, processes, placement, beside)
