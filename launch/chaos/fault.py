"""What a fault is: something done to a run, once, at a time that others choose."""

from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Self

from .arena import Arena
from .disturbed_run import WORKING, DisturbedRun


class MissedError(Exception):
    """There was nothing to strike at this time."""


@dataclass(frozen=True)
class Place:
    """Where runs are disturbed."""

    out: Path
    arena: Arena

    def room(self, fault: "Fault") -> Path:
        """The folder for runs that `fault` strikes."""
        return self.arena.small if fault.small else self.out


class Fault:
    """One kind of fault. Used as a context manager around a run.

    Attributes:
        phases: of `chaos_run.PHASES`, in which it strikes.
        flags: of the launcher; a run with them ends as one without.
        changes: further ones, with which a run ends otherwise: it is held against another one.
        small: the run's folder lies on the arena's small disk.
        forgiving: the launcher itself may end by it, and is resumed.
        impossible: why it cannot be had here.
    """

    phases: tuple[str, ...] = ("start", *WORKING)
    flags: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    small = False
    forgiving = False
    impossible = ""

    def __init__(self, place: Place) -> None:
        self.arena = place.arena

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        pass

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        """Raises MissedError if there is nothing to strike now."""
        raise NotImplementedError
