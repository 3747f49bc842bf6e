"""What the kernel says of processes: whether they run, wait to run, or do nothing.

Where it says nothing (no Linux, or no such process), None or 0 is returned, and nobody is judged.
"""

from pathlib import Path


def thread_times(pid: int) -> frozenset[tuple[str, int]]:
    """Of each thread of a process, the nanoseconds in which it ran or waited for a processor.

    Two that are equal mean that the process did nothing at all between them.
    """
    found = set()
    try:
        for thread in Path(f"/proc/{pid}/task").iterdir():
            ran, waited, _ = map(int, (thread / "schedstat").read_text().split())
            found.add((thread.name, ran + waited))
    except (OSError, ValueError):  # a thread may end meanwhile
        pass
    return frozenset(found)


def processor_time(pid: int) -> int | None:
    """Nanoseconds of processor time of all threads of a process; None where it is not known."""
    try:
        threads = list(Path(f"/proc/{pid}/task").iterdir())
        return sum(int((thread / "schedstat").read_text().split()[0]) for thread in threads)
    except (OSError, ValueError, IndexError):  # a thread may end meanwhile
        return None


def queued(pid: int) -> float:
    """Seconds that a process's main thread was ready to run and others ran; 0 if not known."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9
    except (OSError, ValueError, IndexError):  # it may have ended
        return 0.0


def members(group: int) -> dict[int, str]:
    """The processes of a group: process id -> state, one letter as in /proc/PID/stat."""
    found = {}
    for process in Path("/proc").glob("[0-9]*"):
        try:
            state, _, its = (process / "stat").read_text().rpartition(")")[2].split()[:3]
        except (OSError, ValueError):  # it has ended meanwhile
            continue
        if int(its) == group:
            found[int(process.name)] = state
    return found
