"""Every key of the bus, in one place.

otc/{run}/{description}/{agent}/observation    env host -> that learner
otc/{run}/{description}/{agent}/action         that learner -> env host
otc/{run}/{description}/{agent}/status         that learner -> env host and launcher
otc/{run}/{description}/{agent}/history        query by that learner: its own transitions
otc/{run}/{description}/host/status            env host -> all
otc/{run}/{description}/alive/{process}        liveliness tokens
otc/{run}/host/spec    query by learners: agents, sizes, protocol version, description

{description} is the digest of what env host and learners must agree on. So runs of one name but of
other settings never hear each other, though they meet at one router; and since it is no part of the
spec's key, a learner learns that it was given other settings than the env host.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

HOST = "host"  # the env host's process name; the learners' are their agents' names
OBSERVER = "observer"  # a process that only observes: the launcher
ANY = "*"  # in place of a description's digest, in rules for runs of any


@dataclass(frozen=True)
class Uses:
    """What a process does on the bus: on which keys it does what. It does nothing else."""

    publishes: tuple[str, ...] = ()
    hears: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()
    shows: tuple[str, ...] = ()  # liveliness tokens of its own
    watches: tuple[str, ...] = ()  # liveliness tokens of others

    @property
    def keys(self) -> frozenset[str]:
        """All of them."""
        return frozenset(key for keys in vars(self).values() for key in keys)


@dataclass(frozen=True)
class Keys:
    """The keys of one run. `process` is `HOST` or an agent's name.

    Attributes:
        description: `Description.shared_digest` of the run's; `ANY` where only rules are made.
    """

    run: str
    description: str

    @property
    def _run(self) -> str:
        # Zenoh gives a meaning to /, *, $, ?, # and @ in keys.
        return "otc/" + re.sub(r"[^A-Za-z0-9_.-]", "_", self.run)

    @property
    def _root(self) -> str:
        return f"{self._run}/{self.description}"

    def observation(self, agent: str) -> str:
        return f"{self._root}/{agent}/observation"

    def action(self, agent: str) -> str:
        return f"{self._root}/{agent}/action"

    def status(self, process: str) -> str:
        return f"{self._root}/{process}/status"

    def history(self, agent: str) -> str:
        return f"{self._root}/{agent}/history"

    @property
    def spec(self) -> str:
        return f"{self._run}/{HOST}/spec"

    def alive(self, process: str) -> str:
        return f"{self._root}/alive/{process}"

    def learner_uses(self, agent: str) -> Uses:
        """What the learner of `agent` does, and its launcher, who hears its status."""
        return Uses(
            publishes=(self.action(agent), self.status(agent)),
            hears=(self.observation(agent), self.status(agent), self.status(HOST)),
            asks=(self.spec, self.history(agent)),
            shows=(self.alive(agent),),
            watches=(self.alive(agent), self.alive(HOST)),
        )

    def host_uses(self, agents: Sequence[str]) -> Uses:
        """What the env host does."""
        return Uses(
            publishes=(*map(self.observation, agents), self.status(HOST)),
            hears=(*map(self.action, agents), *map(self.status, agents)),
            answers=(*map(self.history, agents), self.spec),
            shows=(self.alive(HOST),),
            watches=tuple(map(self.alive, (HOST, *agents))),
        )

    def observer_uses(self, agents: Sequence[str]) -> Uses:
        """What a launcher may do that looks at all processes."""
        processes = (HOST, *agents)
        return Uses(
            hears=tuple(map(self.status, processes)), watches=tuple(map(self.alive, processes))
        )
