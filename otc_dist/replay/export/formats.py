"""The formats of `--export`, and what each of them is to the command. A new one: one more line."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Protocol

from otc_dist.replay.export.trajectories import Trajectory
from otc_dist.spec import TeamSpec
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError


@dataclass(frozen=True)
class View:
    """Whose data set it is: one agent's, with nothing of the others, or the whole team's."""

    team: TeamSpec
    agent: int | None  # None: the team's
    about: str  # where the data come from, as JSON

    @property
    def name(self) -> str:
        """What the data set is called: "agent_0", ..., or "joint"."""
        return "joint" if self.agent is None else self.team.agents[self.agent].name

    @property
    def agents(self) -> Sequence[int]:
        """Whose columns it has."""
        return range(len(self.team.agents)) if self.agent is None else (self.agent,)


class Writer(Protocol):
    """Writes one data set. What it takes of the memory does not grow with what it has written."""

    def write(self, batch: Sequence[Trajectory]) -> None:
        """Append trajectories. Raises OSError: the disk is full, ..."""
        ...

    def close(self) -> None:
        """Write what comes last, and let go of all files. Raises OSError."""
        ...


@dataclass(frozen=True)
class Format:
    """`module` has `open_writer(folder, view)`; it and its libraries are imported when needed."""

    module: str
    needs: str  # the libraries
    joint: bool  # whether it has room for the data of several agents
    growth: float  # bytes on the disk, at most, for each byte of data
    overhead: int  # bytes, at most, for each trajectory of an agent
    extra: str = "export"  # of pyproject.toml, which installs the libraries

    def opener(self) -> Callable[[Path, View], Writer]:
        """What begins a data set of a view in a folder.

        Raises:
            UserError: a library that the format needs is not installed.
        """
        try:
            module = import_module(f"{__package__}.{self.module}")
        except ImportError:
            raise UserError(f"this export needs {self.needs}: {install(self.extra)}") from None
        opener: Callable[[Path, View], Writer] = module.open_writer
        return opener


FORMATS: Mapping[str, Format] = {
    "minari": Format("minari_sets", "minari and h5py", joint=True, growth=1.5, overhead=20_000),
    "d4rl": Format("d4rl_files", "h5py", joint=False, growth=1.5, overhead=0),
    "parquet": Format("parquet_files", "pyarrow", joint=True, growth=1.5, overhead=200),
    "lerobot": Format("lerobot_sets", "pyarrow", joint=True, growth=1.5, overhead=400),
    "vault": Format("vaults", "tensorstore", joint=True, growth=1.5, overhead=0, extra="vault"),
    "csv": Format("csv_files", "pyarrow", joint=True, growth=6.0, overhead=0),
}
