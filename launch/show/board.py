"""What the launcher knows of a run from the processes' status messages: no drawing here."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from otc_dist.bus.keys import HOST
from otc_dist.bus.messages import Status
from otc_dist.description.distances import FITS
from otc_dist.terminal.amounts import plus_minus

from ..plan.forecast import Remaining
from ..supervise.health import ProcessHealth


@dataclass
class Board:
    """The newest status of every process, and what has happened, in the order it happened."""

    agents: tuple[str, ...]
    remaining: Remaining
    of_process: Mapping[str, ProcessHealth] = field(
        default_factory=dict
    )  # of the processes started here
    newest: dict[str, Status] = field(default_factory=dict)
    measures: dict[str, dict[str, float]] = field(default_factory=dict)  # agent -> last of each
    events: list[str] = field(default_factory=list)
    seconds_left: float | None = None

    def take(self, status: Status, clock: float) -> None:
        """Note a status that arrived at `clock` seconds."""
        before = self.newest.get(status.process)
        self.newest[status.process] = status
        measures = self.measures.setdefault(status.process, {})
        appeared = {
            name: value for name, value in status.metrics.items() if measures.get(name) != value
        }
        measures.update(status.metrics)
        if before is None or (before.phase, before.deployment) != (status.phase, status.deployment):
            self.events.append(f"{status.process}: {describe_phase(status)}")
        if "alpha" in appeared:
            self.events.append(f"{status.process}: {alpha_line(measures)}")
        if "accepted" in appeared:
            self.events.append(f"{status.process}: accepts {measures['accepted']:.1%} of its data")
        if "return" in appeared:
            won = f", {measures['success']:.1f} % won" if "success" in measures else ""
            self.events.append(f"{status.process}: return {appeared['return']:.1f}{won}")
        if appeared.get("broken_off"):
            self.events.append(
                f"{status.process}: an episode was broken off; actions held so far:"
                f" {measures['held']:,.0f}, late observations: {measures['late']:,.0f}"
            )
        if "measured" in appeared:
            measured = plus_minus(measures["measured"], measures["error"])
            self.events.append(
                f"{status.process}: deployment {status.deployment} measured {measured}"
            )
        slowest = self._slowest()
        if slowest is None:
            self.seconds_left = None
        else:
            share = slowest.update / slowest.total if slowest.total else 0.0
            self.seconds_left = self.remaining.seconds(
                slowest.phase, slowest.deployment, share, clock
            )

    def drain_events(self) -> list[str]:
        """The events since the last call."""
        events, self.events = self.events, []
        return events

    def _slowest(self) -> Status | None:
        """Who the others wait for: the agent that has trained least, or the host."""
        known = [self.newest[name] for name in self.agents if name in self.newest]
        if len(known) < len(self.agents) or any(s.phase in ("starting", "waiting") for s in known):
            return None
        training = [status for status in known if status.phase in TRAINING]
        if not training:
            return self.newest.get(HOST)
        return min(
            training,
            key=lambda s: (s.deployment, TRAINING.index(s.phase), s.update / max(s.total, 1)),
        )

    @property
    def busy(self) -> list[Status]:
        """The statuses whose progress is worth a line: of the agents that train, or else of the
        host once it has begun; that it waits, for whom or what, is an event and reported once.
        """
        training = [
            self.newest[name]
            for name in self.agents
            if name in self.newest and self.newest[name].phase in TRAINING
        ]
        host = self.newest.get(HOST)
        return training or ([host] if host and host.update else [])

    @property
    def over(self) -> bool:
        """Whether the env host has said that all is done."""
        return HOST in self.newest and self.newest[HOST].phase == "done"


TRAINING = ("offline", *FITS, "tuning")


def describe_phase(status: Status) -> str:
    """Where a process is: `tuning after deployment 2`, `offline`."""
    if status.phase == "tuning":
        return f"tuning after deployment {status.deployment}"
    if status.phase in ("evaluation", "ready"):
        return f"{status.phase}, policy {status.deployment}"
    if status.phase == "waiting":
        return "waiting for the env host"
    if status.phase == "gathering":
        return "waiting for the learners to come"
    if status.phase == "approval":
        return f"waiting for a person to approve deployment {status.deployment}"
    if status.phase == "reset":
        return f"waiting for a reset in deployment {status.deployment}"
    if status.phase == "done":
        return "done"
    return f"{status.phase} {status.deployment}" if status.deployment else status.phase


def alpha_line(measures: dict[str, float]) -> str:
    """Eq. 4's outcome: alpha and the similarity D of the newest data to B_0."""
    similarity = measures.get("similarity")
    shown = f", 𝔻 {similarity:.3f}" if similarity is not None else ""
    return f"alpha {measures['alpha']:.3f}{shown}"
