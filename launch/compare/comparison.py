"""Comparisons as they are done: one by `launch compare`, several by `launch campaign`."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from otc_dist.comparison import arms as arms_of
from otc_dist.comparison import collected, report, tables
from otc_dist.comparison.arms import Arms
from otc_dist.comparison.score_statistics import summarise
from otc_dist.comparison.scores import ComparisonFolder, Run
from otc_dist.description import Description
from otc_dist.description.assignments import key_of
from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import say

from ..plan import descriptions
from ..plan.new_folder import NewFolder
from ..run.resolve import resolve
from ..supervise.jobs import Job
from ..supervise.processes import MISTAKE
from . import cluster, held_folder, job_graph

EPISODES = 30  # greedy episodes that a comparison needs at least


@dataclass(frozen=True)
class Comparison:
    """Arms of one description, over seeds, in a folder.

    Attributes:
        base: resolved, as `prepare` gives it.
        results: where the raw scores of complete seeds are kept as well; None: nowhere.
        name: what tells it from the others of a campaign; "": it is alone.
    """

    folder: ComparisonFolder
    base: Description
    arms: Arms
    seeds: Sequence[int]
    quick: bool
    results: Path | None = None
    name: str = ""

    def jobs(self, seeds: Sequence[int]) -> list[Job]:
        """Its jobs for some of its seeds; in a campaign they are called by its name.

        Raises:
            UserError: a finished run is of another description, or damaged.
        """
        jobs = job_graph.comparison(self.folder, self.base, self.arms, seeds, self.seeds)
        if not self.name:
            return jobs
        return [replace(job, name=f"{self.name}, {job.name}") for job in jobs]

    def complete(self) -> list[int]:
        """The seeds for which every arm has its run."""
        return [s for s in self.seeds if all(self.folder.run(s, arm).exists() for arm in self.arms)]

    def conclude(self) -> None:
        """Print and write what the complete seeds show, and copy their raw scores to `results`.

        One of a campaign prints a line: its tables are in its report.
        """
        complete, whose = self.complete(), f"{self.name}: " if self.name else ""
        if not complete:
            say(f"{whose}no seed is complete for all of {', '.join(self.arms)} yet")
            return
        if self.results is not None:
            collected.keep(self.folder, self.arms, complete, self.results)
        runs = {arm: [Run.read(self.folder.run(s, arm)) for s in complete] for arm in self.arms}
        env_id = self.base.env.id
        summary = summarise(runs, lambda value: registry.normalised_score(env_id, value))
        label = label_of(self.folder.quick.exists(), self.base.evaluation.episodes)
        report.write(self.folder, self.base, self.arms, summary, runs, label)
        of_all = "" if len(complete) == len(self.seeds) else f" of {len(self.seeds)}: so far"
        count = f"{len(complete)} complete {'seed' if len(complete) == 1 else 'seeds'}"
        heading = f"{whose}{count}{of_all}{f' ({label})' if label else ''}"
        if self.name:
            say(f"{heading}; report: {self.folder.report}")
        else:
            say("", heading, *tables.text(summary), f"report: {self.folder.report}", "")


def label_of(quick: bool, episodes: int) -> str:
    """What is said of a comparison that is no real result; "" of one that is.

    Args:
        quick: whether it was begun as a quick look.
        episodes: greedy ones of an evaluation; so few that `--quick` alone allows it say the same,
            also of what an earlier version began.
    """
    return descriptions.QUICK_LABEL if quick or episodes < EPISODES else ""


def check_settings(assignments: Iterable[str]) -> None:
    """Raises UserError: one would do nothing."""
    if any(key_of(text) == "seed" for text in assignments):
        raise UserError("a comparison's seeds are those of --seeds: leave out --set seed")


def check_size(base: Description, quick: bool) -> None:
    """Raises UserError: so few greedy episodes are for a quick look only."""
    if base.evaluation.episodes < EPISODES and not quick:
        raise UserError(
            f"a comparison needs evaluation.episodes >= {EPISODES}, not"
            f" {base.evaluation.episodes}: returns are too noisy (--quick allows fewer, as a look)"
        )


def prepare(
    loaded: Description, names: str | None, own: Iterable[str], quick: bool
) -> tuple[Description, Arms]:
    """The description as it is run, and its arms, each built once, so that a mistake shows early.

    Args:
        names: of known arms, comma-separated; None: the usual ones.
        own: arms of the user's, each `name=section.key=value,section.key=value`.

    Raises:
        UserError: an arm is unknown or does not fit, or nothing could be compared.
    """
    arms = arms_of.parse_arms(",".join(arms_of.USUAL) if names is None else names, own)
    base = resolve(loaded)
    check_size(base, quick)
    if not base.deployment.count:
        raise UserError("a comparison needs deployment.count >= 1: otherwise nothing is tuned")
    arms_of.check(base, arms)
    return base, arms


def jobs_of(comparisons: Sequence[Comparison]) -> list[Job]:
    """All jobs: the first seed of every comparison, then the second, and so on, so that what is
    done are complete seeds of all. What several need, like data, is made once.

    Raises:
        UserError: a finished run is of another description, or damaged.
    """
    found: dict[Path, Job] = {}
    for seed in dict.fromkeys(seed for one in comparisons for seed in one.seeds):
        for one in comparisons:
            for job in one.jobs([seed]) if seed in one.seeds else ():
                found.setdefault(job.product, job)
    return list(found.values())


def carry_out(
    root: Path,
    comparisons: Sequence[Comparison],
    queue: tuple[str, ...] | None,
    whole: Callable[[], None] = lambda: None,
) -> int:
    """Do what is left: on this machine or, where `queue` has options for it, in SLURM's queue.

    Args:
        root: the folder that holds theirs, for people.
        whole: called when the first job is done, when a seed of all is complete, and in the end.

    Returns:
        the exit status.

    Raises:
        UserError: a folder is not theirs, or anything else that the user can fix.
    """
    with ExitStack() as held:
        new = []
        for one in comparisons:
            new.append(held.enter_context(held_folder.opened(one.folder, one.base, one.quick)))
            if one.results is not None:  # a mistake shows before anything runs
                collected.check(one.folder, one.results, one.arms, one.seeds)
        status = _do(root, comparisons, new, queue, whole)
        whole()
        return status


def _do(
    root: Path,
    comparisons: Sequence[Comparison],
    folders: Sequence[NewFolder],
    queue: tuple[str, ...] | None,
    whole: Callable[[], None],
) -> int:
    """The same, with their folders held."""
    for one, folder in zip(comparisons, folders, strict=True):
        folder.given |= {*job_graph.take_offline(one.folder, one.base, one.arms, one.seeds)}
    jobs = jobs_of(comparisons)
    if taken := sum(len(folder.given) for folder in folders):
        say(f"{taken} offline policies are those that an earlier comparison trained")
    left = sum(not job.done for job in jobs)
    say(f"{root}: {len(jobs)} jobs, {left} of them to do")
    if queue is not None:
        status = cluster.submit(jobs, queue) if left else 0
        for one in comparisons:
            one.conclude()
        return status
    complete = [len(one.complete()) for one in comparisons]
    begun = False  # a job of theirs is done: they will stay

    def finished(job: Job) -> None:
        """Show the result so far whenever one more seed is complete for all arms."""
        nonlocal begun
        for index, one in enumerate(comparisons):
            if job.product == job_graph.data_file(one.base):  # the data have been made
                held_folder.note_inputs(one.folder, one.base)
            own = job.product.is_relative_to(one.folder.root)
            if own and not begun:
                begun = True
                whole()
            if own and len(one.complete()) > complete[index]:
                seeds = min(complete)
                complete[index] += 1
                one.conclude()
                if seeds < min(complete) < len(one.seeds):  # the last is shown in the end
                    whole()

    for folder in folders:
        folder.given |= job_graph.outputs(jobs, folder.root)
    patience = max(one.base.bus.answer_deadline for one in comparisons)
    status = job_graph.do(jobs, [one.folder for one in comparisons], patience, finished)
    if status == MISTAKE:
        for folder in reversed(folders):  # in which none was done
            folder.take_away()
    if not left or status:  # else each was shown when its last job finished
        for one in comparisons:
            one.conclude()
    return status
