"""A campaign's file: which descriptions, data sets, arms and seeds are compared."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, PositiveInt

from otc_dist.comparison.arms import Arms
from otc_dist.comparison.campaign.published import Figure, Published
from otc_dist.description import Description, toml_file
from otc_dist.description.assignments import key_of
from otc_dist.description.section import Section
from otc_dist.names import Name
from otc_dist.terminal.errors import UserError

from ..plan import descriptions
from .comparison import check_settings, prepare

FORM = """\
  seeds = "20..24"
  [parts.bcq]
  descriptions = ["2agent_walker2d", "3agent_hopper"]  # names, or TOML files
  datasets = ["random", "medium"]                      # without them, each description's own
  set = ["algorithm.name=bcq", "offline.updates=100000"]
  arms = ["paper-value", "uniform"]                    # without them, compare's usual ones
  arm = ["strict=sampling.name=otc,sampling.share=0.02"]  # more, of your own
  agents = [2, 4]                                      # of a task for any number of them
"""


class Part(Section):
    """Comparisons that differ in the task and the data alone: every description on every data set,
    with every number of agents.

    Its other settings are called as the flags of `compare` are.
    """

    descriptions: Annotated[tuple[str, ...], Field(min_length=1)]
    datasets: tuple[str, ...] = ()
    agents: tuple[PositiveInt, ...] = ()
    set: tuple[str, ...] = ()
    arms: tuple[str, ...] = ()
    arm: tuple[str, ...] = ()


@dataclass(frozen=True)
class Prepared:
    """One comparison of a campaign, ready to be done: what `prepare` gives, and its name."""

    name: str
    base: Description
    arms: Arms


class Campaign(Section):
    """What the file says."""

    seeds: str
    parts: Annotated[dict[Name, Part], Field(min_length=1)]
    summary: str = ""
    published: Published | None = None  # what is printed beside ours
    figures: tuple[Figure, ...] = ()  # the claims that are judged

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a file. Raises UserError for one that is none."""
        return toml_file.load(cls, path, "the campaign")

    def comparisons(self, quick: bool) -> Iterator[Prepared]:
        """All of them, each called by its description, with the number of agents that the part
        gives it, the level of its data and its part.

        Raises:
            UserError: one cannot be made as the file says, or has another's name.
        """
        names = set()
        for key, part in self.parts.items():
            try:
                for one in _of(key, part, quick):
                    if one.name in names:
                        raise UserError(f"{one.name} is there twice")
                    names.add(one.name)
                    yield one
            except UserError as error:
                raise UserError(f"parts.{key}: {error}") from None


def _of(key: str, part: Part, quick: bool) -> Iterator[Prepared]:
    """The comparisons of a part. Raises UserError.

    With `quick` its sizes are those of every part: a file says how large a real one is.
    """
    check_settings(part.set)
    sizes = {key_of(text) for text in descriptions.QUICK} if quick else set()
    changes = [text for text in part.set if key_of(text) not in sizes]
    for description, agents, dataset in product(
        part.descriptions, part.agents or (None,), part.datasets or (None,)
    ):
        data = () if dataset is None else (f"dataset.name={dataset}",)
        team = () if agents is None else (f"env.agents={agents}",)
        loaded = descriptions.load(description, [*data, *team, *changes], None, quick)
        if agents is not None:
            loaded = loaded.with_assignments(f"name={loaded.name}-{agents}")
        base, arms = prepare(loaded, ",".join(part.arms) or None, part.arm, quick)
        level = base.dataset.name.rpartition("/")[2]
        yield Prepared(f"{base.name}-{level}-{key}", base, arms)


def is_campaign(path: Path) -> bool:
    """Whether a file is meant as a campaign's, with mistakes in it or not: it has parts."""
    try:
        return "parts" in toml_file.read(path)
    except UserError:
        return False


def shipped() -> dict[str, Path]:
    """Every campaign that comes with the package: name -> TOML file."""
    folder = Path(__file__).parents[1] / "campaigns"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def find(name: str) -> Path:
    """The TOML file that `name`, a shipped campaign's name or a path, stands for.

    Raises:
        UserError: no shipped campaign has this name (the nearest is suggested).
    """
    return descriptions.find_file(name, "campaign", shipped())
