"""A comparison's page and JSON once more, from the raw scores in its folder."""

from dataclasses import dataclass
from pathlib import Path

from otc_dist.comparison import report
from otc_dist.comparison.score_statistics import summarise
from otc_dist.comparison.scores import ComparisonFolder, Run
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.names import Name
from otc_dist.run.folder import RunFolder
from otc_dist.system import records
from otc_dist.terminal.errors import UserError


@dataclass(frozen=True)
class _Arm:
    name: Name


@dataclass(frozen=True)
class _Before:
    """What of the earlier comparison.json is needed."""

    label: str
    arms: list[_Arm]


def is_comparison(root: Path) -> bool:
    """Whether a folder is a comparison's."""
    return (root / "description.toml").is_file() and (root / "seeds").is_dir()


def check(root: Path) -> None:
    """Raises UserError: it has kept raw scores, of which no page is made again."""
    if not is_comparison(root) and next(root.glob("seed_*/*.json"), None):
        raise UserError(f"{root} holds kept raw scores: launch compare --tables {root} shows them")


def write_again(found: RunFolder) -> Path:
    """Write comparison.json and comparison.html of all seeds that are complete; the page's path.

    Raises:
        UserError: no seed is complete yet, a file is damaged, or they cannot be written.
    """
    root = found.root
    folder = ComparisonFolder(root)
    try:
        before = records.read_json(_Before, folder.results)
    except FileNotFoundError:
        raise UserError(f"{root}: no seed is complete yet; launch compare continues it") from None
    names = [arm.name for arm in before.arms]
    seeds = [
        int(path.name.removeprefix("seed_"))
        for path in sorted((root / "seeds").glob("seed_*"))
        if all((path / f"{name}.json").exists() for name in names)
    ]
    runs = {name: [Run.read(folder.run(seed, name)) for seed in seeds] for name in names}
    if not seeds or not names:
        raise UserError(f"{root}: no seed is complete for all of {', '.join(names)}")
    base = Description.load(folder.description)
    arms = {name: tuple(of_arm[0].assignments) for name, of_arm in runs.items()}
    summary = summarise(runs, lambda value: registry.normalised_score(base.env.id, value))
    report.write(folder, base, arms, summary, runs, before.label)
    return folder.report
