"""A comparison as jobs: data, offline training of every agent, pi_0's evaluation, every arm."""

import hashlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from otc_dist.comparison import offline_cache
from otc_dist.comparison.arms import ANALYSES, Arms, describe, offline_files
from otc_dist.comparison.scores import OFFLINE, ComparisonFolder
from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.system.cache import compiled_root

from ..plan import forecast
from ..supervise.jobs import FailedError, Job, StoppedError, cores, run_jobs
from . import cluster

ANALYSIS = 20.0  # seconds that an analysis takes a deployment
TOGETHER = 10  # seeds at most whose offline updates are made at once: each holds the data
MODULE = (sys.executable, "-m")


def do(
    jobs: Sequence[Job],
    folders: Sequence[ComparisonFolder],
    patience: float,
    finished: Callable[[Job], None],
) -> int:
    """Do the jobs on this machine's cores, or say why not. Returns the exit status.

    Args:
        folders: of the comparisons whose jobs these are.
        patience: seconds that a job may stand still.

    Raises:
        UserError: some of them are in a cluster's queue.
    """
    cluster.keep_out(jobs, [folder.root for folder in folders])
    try:
        run_jobs(jobs, cores(), finished, patience)
    except FailedError as failed:
        print(f"error: {failed}", file=sys.stderr)
        return failed.status
    except StoppedError as stopped:
        print(f"stopped by {stopped}; the same command continues")
        return stopped.status
    return 0


def outputs(jobs: Sequence[Job], root: Path) -> set[Path]:
    """What they will print to in a folder, as far as it is not there yet."""
    new = (job.output for job in jobs if not job.done and not job.output.exists())
    return {output for output in new if output.is_relative_to(root)}


def _data(folder: ComparisonFolder, base: Description) -> Job:
    """The data set."""
    dataset = base.dataset
    make = (*MODULE, "otc_dist.datasets", "make", dataset.name)
    return Job(
        "data",
        (*make, "--transitions", str(dataset.transitions)),
        data_file(base),
        folder.root / "output" / "data.log",
        seconds=120,
    )


def data_file(base: Description) -> Path:
    """The last file of the data set: it is there when all are."""
    last = registry.team_spec(base.env.id).names[-1]
    return store.agent_file(base.dataset.name, last, base.dataset.transitions)


def _mark(base: Description) -> Path:
    """The mark that what offline training runs has been compiled: it lies beside that code."""
    depends_on = f"{base.offline_digest()} {offline_cache.surroundings()}"
    return compiled_root() / f"offline-{hashlib.sha256(depends_on.encode()).hexdigest()[:16]}.done"


def _compiled_first(folder: ComparisonFolder, base: Description, jobs: list[Job]) -> list[Job]:
    """The same with a job that compiles, while data are made, what all that begin at once would
    compile otherwise. `jobs`: the data's first.
    """
    data = jobs[0]
    training = [job for job in jobs if data.product in job.needs and not job.done]
    if base.engine.name == "eager" or not training:
        return jobs
    mark, output = _mark(base), folder.root / "output" / "compile.log"
    command = _piece(folder, base.seed, output, "compile", str(mark))
    code = Job("compiled code", command, mark, output, seconds=60)
    waiting = {job.name: replace(job, needs=(*job.needs, code.product)) for job in training}
    return [data, code, *(waiting.get(job.name, job) for job in jobs[1:])]


def _together(
    folder: ComparisonFolder,
    base: Description,
    seed: int,
    seeds: Sequence[int],
    agent: str,
    assignments: Sequence[str],
) -> tuple[int, ...]:
    """The seeds, this one among them, whose pi_0 of an agent one process trains: on a GPU, which
    the small updates of one leave idle, of each ten those that are missing; else it alone.

    Args:
        seeds: all that are compared.
    """

    def missing(one: int) -> bool:
        files = offline_files(folder, base, describe(base, assignments, one))
        return not files.checkpoint(agent, 0).exists()

    if base.engine.name != "cuda-graph":
        return (seed,)
    if describe(base, assignments, seed).offline.rows != "all":  # others differ by the seed
        return (seed,)
    ten = [one for one in seeds if one // TOGETHER == seed // TOGETHER]
    found = tuple(one for one in ten if missing(one))
    return found if seed in found else (seed,)


def _training(
    folder: ComparisonFolder,
    base: Description,
    seed: int,
    seeds: Sequence[int],
    data: Job,
    assignments: Sequence[str] = (),
    owner: str = "",
) -> list[Job]:
    """Offline training of every agent of a seed: for all arms, or for `owner` with its own pi_0.

    Where that is one of several seeds' at once, the jobs are theirs as well.
    """
    jobs = []
    for agent in registry.team_spec(base.env.id).names:
        trained = _together(folder, base, seed, seeds, agent, assignments)
        last, listed = trained[-1], ",".join(map(str, trained))  # its pi_0 is written last
        description = describe(base, assignments, last)
        output = folder.output(last, f"offline_{agent}{owner and f'_{owner}'}")
        jobs.append(
            Job(
                f"seed{'s' * (len(trained) > 1)} {listed}, {agent}"
                f" offline{owner and f' for {owner}'}",
                _piece(folder, listed, output, "offline", agent, *assignments),
                offline_files(folder, base, description).checkpoint(agent, 0),
                output,
                (data.product,),
                forecast.offline(description, len(trained)) + len(trained) * forecast.fits(base),
                shared=forecast.offline(description, 0),
            )
        )
    return jobs


def _trained_and_evaluated(
    folder: ComparisonFolder,
    base: Description,
    seed: int,
    seeds: Sequence[int],
    data: Job,
    assignments: Sequence[str] = (),
    owner: str = "",
) -> list[Job]:
    """The same, and the evaluation of pi_0 last."""
    training = _training(folder, base, seed, seeds, data, assignments, owner)
    files = offline_files(folder, base, describe(base, assignments, seed))
    output = folder.output(seed, f"pi_0{owner and f'_{owner}'}")
    evaluation = Job(
        f"seed {seed}, evaluation of pi_0{owner and f' for {owner}'}",
        _piece(folder, seed, output, "pi_0", *assignments),
        files.root / OFFLINE,
        output,
        tuple(job.product for job in training),
        seconds=15,
    )
    return [*training, evaluation]


def take_offline(
    folder: ComparisonFolder, base: Description, arms: Arms, seeds: Sequence[int]
) -> list[Path]:
    """Take the offline policies that earlier comparisons have trained; returns their files.

    Raises:
        UserError: the environment or the code that they name cannot be loaded.
    """
    agents = registry.team_spec(base.env.id).names
    missing: dict[Path, tuple[Description, str, Path, tuple[int, ...]]] = {}
    for seed in seeds:
        for assignments in dict.fromkeys([(), *arms.values()]):
            description = describe(base, assignments, seed)
            files = offline_files(folder, base, description)
            for agent in agents:
                if not (wanted := files.checkpoint(agent, 0)).exists():
                    trained = _together(folder, base, seed, seeds, agent, assignments)
                    missing.setdefault(wanted, (description, agent, wanted, trained))
    # None is taken before it is known which would be trained with which.
    return [wanted for wanted, what in missing.items() if offline_cache.fetch(*what)]


def comparison(
    folder: ComparisonFolder,
    base: Description,
    arms: Arms,
    seeds: Sequence[int],
    every: Sequence[int] = (),
) -> list[Job]:
    """All jobs, seed by seed, so that what is done are complete seeds.

    Args:
        every: all seeds that are compared, if those are some of them.

    Raises:
        UserError: a finished run is of another description, or damaged.
    """
    data, every = _data(folder, base), every or seeds
    jobs = [data]
    for seed in seeds:
        # By where pi_0 lies: several arms may have one of their own together.
        shared = _trained_and_evaluated(folder, base, seed, every, data)
        offline = {folder.seed(seed).root: shared}
        jobs += shared
        for arm, assignments in arms.items():
            description = describe(base, assignments, seed)
            folder.finished(seed, arm, description.digest())
            root = offline_files(folder, base, description).root
            if root not in offline:
                own = _trained_and_evaluated(folder, base, seed, every, data, assignments, arm)
                jobs += own
                offline[root] = own
            output = folder.output(seed, arm)
            jobs.append(
                Job(
                    f"seed {seed}, arm {arm}",
                    _piece(folder, seed, output, "arm", arm, *assignments),
                    folder.run(seed, arm),
                    output,
                    tuple(job.product for job in offline[root]),
                    _tuning_seconds(description, ANALYSIS if arm in ANALYSES else 0.0),
                )
            )
    return _compiled_first(folder, base, list(dict.fromkeys(jobs)))


def mechanism(
    folder: ComparisonFolder,
    base: Description,
    seeds: Sequence[int],
    name: str,
    assignments: Sequence[str],
) -> list[Job]:
    """Offline training where it is missing, and the mechanism check `name` of every seed."""
    data = _data(folder, base)
    training = {seed: _training(folder, base, seed, seeds, data) for seed in seeds}
    jobs = [
        data,
        *dict.fromkeys(job for of_seed in training.values() for job in of_seed),
        *(
            Job(
                f"seed {seed}, mechanism",
                _piece(
                    folder, seed, folder.output(seed, "mechanism"), "mechanism", name, *assignments
                ),
                folder.mechanism(name, seed),
                folder.output(seed, "mechanism"),
                tuple(job.product for job in training[seed]),
                seconds=120,
            )
            for seed in seeds
        ),
    ]
    return _compiled_first(folder, base, jobs)


def _piece(
    folder: ComparisonFolder, seeds: int | str, output: Path, *piece: str
) -> tuple[str, ...]:
    job = "otc_dist.launch.compare.job"
    return (*MODULE, job, str(folder.root), str(seeds), str(output), *piece)


def _tuning_seconds(description: Description, analysis: float) -> float:
    """Of a run; `analysis`: of what is looked at after each deployment."""
    team = registry.team_spec(description.env.id)
    once = forecast.tuning(description) + forecast.acting(description, team)
    each = once + forecast.judging(description, team)
    return 10 + description.deployment.count * (len(team.agents) * each + analysis)
