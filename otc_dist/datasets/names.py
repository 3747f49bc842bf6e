"""Names of data sets and where they lie.

A name is `<env_id>/<level>`: a level that the task's `Source` makes when it is needed, or the name
that an import gave. The folder of a set is `<cache>/datasets/<env_id>/<level>/<transitions>`.
"""

from dataclasses import dataclass
from pathlib import Path

from otc_dist.datasets.source import Source
from otc_dist.datasets.sources import source_of
from otc_dist.envs import registry
from otc_dist.names import is_name
from otc_dist.system.cache import cache_root
from otc_dist.terminal.errors import UserError, unknown


@dataclass(frozen=True)
class DatasetName:
    """A checked name: `env_id` is known, and `level` is made or a plain word."""

    env_id: str
    level: str

    @classmethod
    def parse(cls, name: str) -> "DatasetName":
        """Raises UserError, with the nearest known name, if there is no such data set."""
        env_id, _, level = name.rpartition("/")
        if registry.known(env_id) and is_name(level):
            parsed = cls(env_id, level)
            if parsed.source or parsed.sizes():
                return parsed
            source = source_of(env_id)
            if source and env_id not in registry.env_ids():  # no list has names of it to suggest
                raise UserError(
                    f"there is no data set {name}: of {env_id} only"
                    f" {' and '.join(source.levels(env_id))} can be made; other data can be"
                    " imported, see python -m otc_dist.datasets import --help"
                )
        raise unknown("data set", name, map(str, known_names()))

    @property
    def source(self) -> Source | None:
        """Who makes this set, at any size; None if it was imported."""
        source = source_of(self.env_id)
        return source if source and self.level in source.levels(self.env_id) else None

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
        if source := self.source:
            return source.usual_size(self.env_id, self.level)
        return self.sizes()[-1]

    def set_folder(self, transitions: int = 0) -> Path:
        """The folder of the set of that size (0: the usual size). UserError for a bad size."""
        if transitions < 0:
            raise UserError(f"a data set cannot hold {transitions} transitions; ask for 1 or more")
        if not self.source and transitions not in (0, *self.sizes()):
            raise UserError(
                f"{self} was imported with {self.usual_size()} transitions and comes in no other "
                "size; ask for that number, or for 0, which means all"
            )
        return self.folder / str(transitions or self.usual_size())

    def __str__(self) -> str:
        return f"{self.env_id}/{self.level}"


def known_names() -> tuple[DatasetName, ...]:
    """All data sets that can be had now: those we make of the usual tasks, then those cached."""
    made = [
        DatasetName(env_id, level)
        for env_id in registry.env_ids()
        if (source := source_of(env_id))
        for level in source.levels(env_id)
    ]
    root = cache_root() / "datasets"
    cached = [
        name
        for folder in sorted([*root.glob("*/*"), *root.glob("*/*/*")])  # an id may have a slash
        if registry.known(env_id := folder.parent.relative_to(root).as_posix())
        and (name := DatasetName(env_id, folder.name)) not in made
        and name.sizes()
    ]
    return tuple(made + cached)
