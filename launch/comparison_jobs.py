"""A comparison as jobs: data, offline training of every agent, pi_0's evaluation, every arm."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from otc_dist.comparison.arms import Arms, describe
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.errors import UserError
from otc_dist.run_folder import RunFolder

from . import forecast, run_record
from .jobs import Job

MODULE = (sys.executable, "-m")


@contextmanager
def opened(folder: ComparisonFolder, base: Description) -> Iterator[None]:
    """The folder, held against other launchers, with `base` as its description.

    Raises:
        UserError: it is held, cannot be written, or is of another description.
    """
    try:
        folder.root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make {folder.root}: {error.strerror}") from None
    with run_record.locked(RunFolder(folder.root)):
        if folder.description.exists():
            _same(Description.load(folder.description), base, folder)
        elif any(path.name != ".lock" for path in folder.root.iterdir()):
            raise UserError(f"{folder.root} holds something else; use another --out")
        else:
            folder.description.write_text(base.to_toml(), encoding="utf-8")
        yield


def _same(found: Description, wanted: Description, folder: ComparisonFolder) -> None:
    """Raises UserError, naming the first difference."""
    before, now = _flat(found), _flat(wanted)
    for key, value in now.items():
        if before[key] != value:
            raise UserError(
                f"{folder.root} was begun with {key} = {before[key]}, and this is {value};"
                " use another --out"
            )


def _flat(description: Description) -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in description.model_dump(mode="json").items():
        below = value.items() if isinstance(value, dict) else ()
        flat |= {f"{key}.{name}": item for name, item in below} or {key: value}
    return flat


def offline(folder: ComparisonFolder, base: Description, seeds: Sequence[int]) -> list[Job]:
    """The data set, then pi_0 of every seed and agent."""
    dataset = base.dataset
    agents = registry.team_spec(base.env.id).names
    seconds = forecast.offline(base) + forecast.fits(base)
    files = [store.agent_file(dataset.name, agent, dataset.transitions) for agent in agents]
    make = (*MODULE, "otc_dist.datasets", "make", dataset.name)
    data = Job(
        "data",
        (*make, "--transitions", str(dataset.transitions)),
        files[-1],
        folder.root / "output" / "data.log",
        seconds=120,
    )
    training = [
        Job(
            f"seed {seed}, {agent} offline",
            _piece(folder, seed, "offline", agent),
            folder.seed(seed).checkpoint(agent, 0),
            folder.output(seed, f"offline_{agent}"),
            (data.product,),
            seconds,
        )
        for seed in seeds
        for agent in agents
    ]
    return [data, *training]


def comparison(
    folder: ComparisonFolder, base: Description, arms: Arms, seeds: Sequence[int]
) -> list[Job]:
    """All jobs, seed by seed, so that what is done are complete seeds.

    Raises:
        UserError: a finished run is of another description, or damaged.
    """
    data, *training = offline(folder, base, seeds)
    jobs = [data]
    for seed in seeds:
        mine = [job for job in training if job.product.is_relative_to(folder.seed(seed).root)]
        checkpoints = tuple(job.product for job in mine)
        evaluation = Job(
            f"seed {seed}, evaluation of pi_0",
            _piece(folder, seed, "pi_0"),
            folder.offline(seed),
            folder.output(seed, "pi_0"),
            checkpoints,
            seconds=15,
        )
        jobs += [*mine, evaluation]
        for arm, assignments in arms.items():
            description = describe(base, assignments, seed)
            folder.finished(seed, arm, description.digest())
            jobs.append(
                Job(
                    f"seed {seed}, arm {arm}",
                    _piece(folder, seed, "arm", arm, *assignments),
                    folder.run(seed, arm),
                    folder.output(seed, arm),
                    (*checkpoints, evaluation.product),
                    _tuning_seconds(description),
                )
            )
    return jobs


def mechanism(
    folder: ComparisonFolder,
    base: Description,
    seeds: Sequence[int],
    name: str,
    assignments: Sequence[str],
) -> list[Job]:
    """Offline training where it is missing, and the mechanism check `name` of every seed."""
    data, *training = offline(folder, base, seeds)
    return [
        data,
        *training,
        *(
            Job(
                f"seed {seed}, mechanism",
                _piece(folder, seed, "mechanism", name, *assignments),
                folder.mechanism(name, seed),
                folder.output(seed, "mechanism"),
                tuple(
                    job.product
                    for job in training
                    if job.product.is_relative_to(folder.seed(seed).root)
                ),
                seconds=120,
            )
            for seed in seeds
        ),
    ]


def _piece(folder: ComparisonFolder, seed: int, *piece: str) -> tuple[str, ...]:
    return (*MODULE, "otc_dist.launch.compare_job", str(folder.root), str(seed), *piece)


def _tuning_seconds(description: Description) -> float:
    team = registry.team_spec(description.env.id)
    once = forecast.tuning(description) + forecast.acting(description, team)
    each = once + forecast.judging(description, team)
    return 10 + description.deployment.count * len(team.agents) * each
