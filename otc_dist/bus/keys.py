"""Every key of the bus, in one place.

otc/{run}/{agent}/observation    env host -> that learner
otc/{run}/{agent}/action         that learner -> env host
otc/{run}/{agent}/status         that learner -> env host and launcher
otc/{run}/{agent}/history        query by that learner: its own transitions, from the log
otc/{run}/host/status            env host -> all
otc/{run}/host/spec              query by learners: agents, sizes, protocol version, description
otc/{run}/alive/{process}        liveliness tokens
"""

import re
from dataclasses import dataclass

HOST = "host"  # the env host's process name; the learners' are their agents' names


@dataclass(frozen=True)
class Keys:
    """The keys of one run. `process` is `HOST` or an agent's name."""

    run: str

    @property
    def _root(self) -> str:
        # Zenoh gives a meaning to /, *, $, ?, # and @ in keys.
        return "otc/" + re.sub(r"[^A-Za-z0-9_.-]", "_", self.run)

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
        return f"{self._root}/{HOST}/spec"

    def alive(self, process: str) -> str:
        return f"{self._root}/alive/{process}"

    def of_learner(self, agent: str) -> tuple[str, ...]:
        """All keys that the learner of `agent` declares or queries, and no others."""
        return (
            self.observation(agent),
            self.action(agent),
            self.status(agent),
            self.history(agent),
            self.alive(agent),
            self.spec,
            self.status(HOST),
            self.alive(HOST),
        )
