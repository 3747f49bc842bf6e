"""What a fault is: something done to a run, once, at a time that others choose."""

from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Self

from .disturbed_run import WORKING, DisturbedRun
from .sandbox import Sandbox


class MissedError(Exception):
    """There was nothing to strike at this time."""


@dataclass(frozen=True)
class Setup:
    """What a fault is made with: where runs are disturbed."""

    out: Path
    sandbox: Sandbox

    def folder_for(self, fault: "Fault") -> Path:
        """The folder for runs that `fault` strikes."""
        return self.sandbox.small if fault.small else self.out


class Fault:
    """One kind of fault. Used as a context manager around a run.

    Attributes:
        phases: of `disturbed_run.PHASES`, in which it strikes.
        flags: of the launcher; a run with them ends as one without.
        changes: further ones, with which a run ends differently: it is compared with another one.
        small: the run's folder lies on the sandbox's small disk.
        forgiving: the launcher itself may end by it, and is resumed.
        impossible: why it cannot be had here.
    """

    phases: tuple[str, ...] = ("start", *WORKING)
    flags: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    small = False
    forgiving = False
    impossible = ""

    def __init__(self, setup: Setup) -> None:
        self.sandbox = setup.sandbox

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        pass

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        """Raises MissedError if there is nothing to strike now."""
        raise NotImplementedError
