"""Names of data sets and where they lie.

A name is `<env_id>/<level>`: one of `LEVELS`, which are made when they are needed, or the name
that an import gave. The folder of a set is `<cache>/datasets/<env_id>/<level>/<transitions>`.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from otc_dist.cache import cache_root
from otc_dist.datasets.generate import LEVELS, Level, default_transitions
from otc_dist.envs import registry
from otc_dist.envs.robot_specs import PARTITIONS
from otc_dist.errors import UserError, unknown


@dataclass(frozen=True)
class DatasetName:
    """A checked name: `env_id` is known, and `level` is one of `LEVELS` or a plain word."""

    env_id: str
    level: str

    @classmethod
    def parse(cls, name: str) -> "DatasetName":
        """Raises UserError, with the nearest known name, if there is no such data set."""
        env_id, _, level = name.partition("/")
        if registry.known(env_id) and plain(level):
            parsed = cls(env_id, level)
            if parsed.made_level or parsed.sizes():
                return parsed
        raise unknown("data set", name, map(str, known_names()))

    @property
    def made_level(self) -> Level | None:
        """The level if we make this set ourselves, at any size; None if it was imported."""
        if self.env_id not in PARTITIONS:
            return None
        return next((level for level in LEVELS if level == self.level), None)

    @property
    def folder(self) -> Path:
        """Holds one folder a size."""
        return cache_root() / "datasets" / self.env_id / self.level

    def sizes(self) -> tuple[int, ...]:
        """Sizes that lie in the cache, ascending."""
        if not self.folder.is_dir():
            return ()
        found = (path.name for path in self.folder.iterdir() if path.is_dir())
        return tuple(sorted(int(size) for size in found if size.isdecimal()))

    def usual_size(self) -> int:
        """Transitions if nobody asks for another size; of an imported set, what was imported."""
        if level := self.made_level:
            return default_transitions(self.env_id, level)
        return self.sizes()[-1]

    def set_folder(self, transitions: int = 0) -> Path:
        """The folder of the set of that size (0: the usual size). UserError for a bad size."""
        if transitions < 0:
            raise UserError(f"a data set cannot hold {transitions} transitions; ask for 1 or more")
        if not self.made_level and transitions not in (0, *self.sizes()):
            raise UserError(
                f"{self} was imported with {self.usual_size()} transitions and comes in no other "
                "size; ask for that number, or for 0, which means all"
            )
        return self.folder / str(transitions or self.usual_size())

    def __str__(self) -> str:
        return f"{self.env_id}/{self.level}"


def plain(level: str) -> bool:
    """Whether `level` can be a folder's name everywhere: letters, digits, and `_.-` inside."""
    return re.fullmatch(r"\w[\w.-]*", level, re.ASCII) is not None


def known_names() -> tuple[DatasetName, ...]:
    """All data sets that can be had now: those we make, then those imported."""
    made = [DatasetName(env_id, level) for env_id in PARTITIONS for level in LEVELS]
    imported = [
        name
        for env_id in registry.env_ids()
        for folder in sorted((cache_root() / "datasets" / env_id).glob("*"))
        if (name := DatasetName(env_id, folder.name)) not in made and name.sizes()
    ]
    return tuple(made + imported)
