"""Raw scores from a folder, and into one: nothing else of a comparison is needed for its tables.

A comparison's folder holds them in seeds/seed_00/ARM.json; a folder that is kept, as under
results/tuning/NAME, in seed_00/ARM.json, with pi_0.json, what the jobs took, and the description
beside.
"""

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from otc_dist.comparison import spent
from otc_dist.comparison.arms import KNOWN, REFERENCE
from otc_dist.comparison.scores import (
    NO_RUNS,
    OFFLINE,
    SPENT,
    ComparisonFolder,
    Run,
    compact,
    read_json,
    to_json,
)
from otc_dist.envs import registry
from otc_dist.run.folder import RunFolder
from otc_dist.system import durable
from otc_dist.terminal.errors import UserError


@dataclass(frozen=True)
class Collected:
    """All finished runs of a comparison, and what it was of."""

    name: str  # the description's
    env_id: str
    dataset: str
    runs: dict[str, list[Run]]  # arm -> its runs by seed; the reference among them
    quick: bool = False  # whether it was begun as a quick look

    @property
    def episodes(self) -> int:
        """Of the evaluation that has the fewest."""
        evaluations = (
            e for of_arm in self.runs.values() for run in of_arm for e in run.evaluations
        )
        return min((len(one.returns) for one in evaluations), default=0)

    def normalise(self, value: float) -> float | None:
        """A return's normalised score, None without reference returns."""
        known = registry.known(self.env_id)
        return registry.normalised_score(self.env_id, value) if known else None


def collect(root: Path) -> Collected:
    """Read every raw score in a folder of either kind.

    Raises:
        UserError: it is none, a file is damaged, or the reference has no run.
    """
    description = root / "description.toml"
    if RunFolder(root).run_json.exists():
        raise UserError(f"{root} is the folder of a run, not of a comparison")
    if not description.is_file():
        raise UserError(f"{root} is not the folder of a comparison: it has no description.toml")
    try:
        # Not by `Description`: raw scores outlast the settings of the version that made them.
        found = tomllib.loads(description.read_text(encoding="utf-8"))
        name, env_id = str(found["name"]), str(found["env"]["id"])
        dataset = str(found["dataset"]["name"])
    except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
        raise UserError(f"{description} is damaged: {error}") from None
    inside = root / "seeds" if (root / "seeds").is_dir() else root
    runs: dict[str, list[Run]] = {}
    for path in sorted(inside.glob("seed_*/*.json")):
        if path.name not in NO_RUNS:
            run = Run.read(path)
            if (run.arm, f"seed_{run.seed:02d}") != (path.stem, path.parent.name):
                raise UserError(f"{path} is of {run.arm}, seed {run.seed}; delete it")
            runs.setdefault(run.arm, []).append(run)
    if REFERENCE not in runs:
        raise UserError(f"{root} holds no run of {REFERENCE}, with which all are compared")
    counts = {len(run.evaluations): run.arm for of_arm in runs.values() for run in of_arm}
    if len(counts) > 1:
        arms = " and ".join(counts.values())
        raise UserError(f"runs in {root} have different numbers of deployments: {arms}")
    order = [*KNOWN, *sorted(runs)]
    runs = {arm: runs[arm] for arm in sorted(runs, key=order.index)}
    return Collected(name, env_id, dataset, runs, ComparisonFolder(root).quick.exists())


def has_scores(root: Path) -> bool:
    """Whether a folder of either kind holds a run of the reference: without it, no table."""
    return any(next(root.glob(f"{at}seed_*/{REFERENCE}.json"), None) for at in ("", "seeds/"))


def check(folder: ComparisonFolder, root: Path, arms: Iterable[str], seeds: Iterable[int]) -> None:
    """See that `keep` can work there, before there is anything to keep; nothing is made.

    Raises:
        UserError: as `keep`; or scores that another comparison has kept there would be replaced.
    """
    if root.resolve() == folder.root.resolve():
        raise UserError(f"--results {root} is the comparison's own folder: use another --results")
    if RunFolder(root).run_json.exists() or ComparisonFolder(root).inputs.exists():
        raise UserError(
            f"--results {root} is the folder of a run or of another comparison, which could then"
            " not go on: use another --results"
        )
    durable.room_for(root)
    _check_same(root / "description.toml", folder.description.read_bytes())
    for seed, arm in product(seeds, arms):
        kept, own = root / f"seed_{seed:02d}" / f"{arm}.json", folder.run(seed, arm)
        if kept.exists() and not (own.exists() and read_json(own) == read_json(kept)):
            raise UserError(
                f"{kept} is not from {folder.root}, and would be replaced: use another --results,"
                " or delete it"
            )


def _check_same(kept: Path, description: bytes) -> None:
    """Raises UserError: what is kept there is of another description."""
    if kept.exists() and kept.read_bytes() != description:
        raise UserError(f"{kept.parent} is of another description; use another --results")


def keep(folder: ComparisonFolder, arms: Iterable[str], seeds: Iterable[int], root: Path) -> None:
    """Copy the description, the raw scores of complete seeds and what they took to a folder that is
    kept, which is to be small: a field a line.

    Raises:
        UserError: it is of another description, or cannot be written.
    """
    try:
        contents = {root / "description.toml": folder.description.read_bytes()}
        if folder.quick.exists():
            contents[ComparisonFolder(root).quick] = folder.quick.read_bytes()
        for seed in seeds:
            into = root / f"seed_{seed:02d}"
            contents[into / OFFLINE] = compact(folder.offline(seed))
            contents |= {into / f"{arm}.json": compact(folder.run(seed, arm)) for arm in arms}
            if took := spent.of_seed(folder, seed):
                contents[into / SPENT] = to_json(took)
        for target, content in contents.items():
            if target.exists() and target.read_bytes() == content:
                continue
            if target.name == "description.toml":
                _check_same(target, content)
            target.parent.mkdir(parents=True, exist_ok=True)
            durable.write(target, content)
    except OSError as error:
        raise UserError(f"cannot keep results in {root}: {error.strerror}") from None
