"""Whether a process that nobody can hear stands still: by what the kernel knows of it."""

from otc_dist.system.kernel import members, thread_times

from .health import FROZEN_AFTER

_STOPPED = ("T", "t")  # states of a process: by a signal, by a debugger


class Standstill:
    """Watches the group of a process: it, and what it has started.

    It stands still while none of their threads has run or waited for a processor. Where the kernel
    does not say, nothing is found.

    Args:
        leader: the process id of the group's leader.
        patience: seconds for which it may stand still.
    """

    def __init__(self, leader: int, patience: float) -> None:
        self._leader, self._patience = leader, patience
        self._used: frozenset[tuple[str, int]] = frozenset()
        self._since: float | None = None  # clock

    def look(self, clock: float) -> str:
        """What it has failed to do for too long; empty: nothing. To be asked again and again."""
        group = members(self._leader)
        used = frozenset(time for pid in group for time in thread_times(pid))
        if self._since is None or used != self._used or not used:
            self._used, self._since = used, clock
            return ""
        stood = clock - self._since
        if group.get(self._leader) in _STOPPED and stood >= min(FROZEN_AFTER, self._patience):
            return "is frozen"
        return f"has done nothing for {self._patience:g} s" if stood >= self._patience else ""
