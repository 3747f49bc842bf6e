"""Where descriptions come from: shipped by name, or a TOML file; and the `--quick` short form."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from otc_dist.datasets.names import DatasetName
from otc_dist.description import Description
from otc_dist.terminal.errors import unknown
from otc_dist.terminal.parser import Parser

# A look at every part of a run in under a minute on two cores: sizes only, never the algorithm.
# Eager, because compiling would take longer than the run.
QUICK = (
    "dataset.transitions=8000",
    "embedding.updates=200",
    "dynamics.updates=200",
    "dynamics.correction_updates=50",
    "offline.updates=500",
    "deployment.count=2",
    "deployment.fraction=0.05",
    "deployment.updates=100",
    "evaluation.episodes=4",
    "sampling.references=400",
    'engine.name="eager"',
)
QUICK_DEPLOYED = 400  # transitions of a deployment, of those 8,000
QUICK_LABEL = "a quick look, not a result"
QUICK_HELP = f"little data and few updates: {QUICK_LABEL}"


def shipped() -> dict[str, Path]:
    """Every description that comes with the package: name -> TOML file."""
    return {path.stem: path for path in sorted(Path(__file__).parents[1].glob("*.toml"))}


def find(name: str) -> Path:
    """The TOML file that `name`, a shipped description's name or a path, stands for.

    Raises:
        UserError: no shipped description has this name (the nearest is suggested).
    """
    return find_file(name, "description", shipped())


def find_file(name: str, kind: str, shipped: Mapping[str, Path]) -> Path:
    """As `find`, of any kind of TOML file that comes with the package."""
    if name.endswith(".toml") or "/" in name or (name not in shipped and Path(name).exists()):
        return Path(name)
    if name not in shipped:
        raise unknown(kind, name, shipped)
    return shipped[name]


def add_flags(parser: Parser, *, required: bool = False) -> None:
    """What says which description it is, of every command that takes one: see `load`."""
    parser.add_argument(
        "description",
        nargs=None if required else "?",
        help="a shipped description's name, or a TOML file",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="section.key=value",
        help="change one value, like sampling.share=0.2; may be given again, and of one setting"
        " the last counts (all settings: docs/reference/settings.md)",
    )
    parser.add_argument("--quick", action="store_true", help=QUICK_HELP)


def load(name: str, assignments: Sequence[str], seed: int | None, quick: bool) -> Description:
    """The description `name` with `--quick`, then `--set`, then `--seed` applied, in that order.

    Raises:
        UserError: see `find` and `Description.load`.
    """
    path, changes = find(name), list(assignments)
    if seed is not None:
        changes.append(f"seed={seed}")
    if quick:
        asked = Description.load(path, changes)
        # By the same strategy: settings of OTC's do not ask for it here.
        strategy = f"sampling.name={asked.sampling.name}"
        sizes = (*QUICK, *_of_imported(asked.dataset.name), *asked.algorithm.brief)
        changes = [*sizes, strategy, *changes]
    return Description.load(path, changes).trusted()


def _of_imported(dataset: str) -> tuple[str, ...]:
    """What makes a look at imported data quick, which come in the size that they have."""
    env_id, _, level = dataset.rpartition("/")
    name = DatasetName(env_id, level)
    if name.source or not (sizes := name.sizes()):
        return ()
    return "dataset.transitions=0", f"deployment.fraction={min(1.0, QUICK_DEPLOYED / sizes[-1])}"
