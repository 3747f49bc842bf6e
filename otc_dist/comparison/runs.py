"""The pieces of a comparison: offline training of one agent, pi_0's evaluation, one arm's run.

All brains of a run live in one process here. Environment seeds and acting noise are keyed by
(seed, phase, deployment, step) only, so arms of a seed are judged on the same episodes.
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory

from otc_dist.comparison import analyses, offline_cache
from otc_dist.comparison.analyses import Analysis
from otc_dist.comparison.arms import ANALYSES, describe, offline_files
from otc_dist.comparison.scores import (
    OFFLINE,
    ComparisonFolder,
    Evaluation,
    Run,
    SamplerMetrics,
    best_of,
    read_json,
    write_json,
)
from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.description.distances import DISTANCES
from otc_dist.envs import registry
from otc_dist.learner import team
from otc_dist.learner.learner import Learner
from otc_dist.learner.together import train_together
from otc_dist.learner.trainer import Progress
from otc_dist.otc.samplers.interface import Sampler
from otc_dist.run.exploration import Schedule
from otc_dist.run.folder import RunFolder
from otc_dist.run.measured_returns import ENOUGH, Measured, TooFewError, horizon
from otc_dist.run.recommendation import reverted
from otc_dist.system.processor import processor
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import JointStep

OnProgress = Callable[[float, str], None]  # share of the job that is done, and where it stands


def train_offline(
    folder: ComparisonFolder,
    base: Description,
    seeds: Sequence[int],
    agent: str,
    on_progress: OnProgress,
    assignments: Sequence[str] = (),
) -> bool:
    """Train pi_0 of one agent, and what any arm's distance fits to B_0, from its newest unfinished
    checkpoint. It is kept for other comparisons as well.

    Returns:
        whether there was no such checkpoint, so that this process did all of it.

    Args:
        seeds: several make their updates at once; the pi_0 of the last of them is written last.
        assignments: those of an arm that has its own pi_0; none: the one that all others share.
    """
    work: list[tuple[Learner, RunFolder]] = []
    for seed in seeds:
        description = describe(base, assignments, seed)
        files = offline_files(folder, base, description)
        if not files.checkpoint(agent, 0).exists():  # of several: before an interruption
            work.append((_learner(description, agent, fits=DISTANCES), files))
    begun = len(work) < len(seeds)
    for learner, files in work:
        if (unfinished := files.offline_checkpoint(agent)).exists():
            learner.load(unfinished)
            begun = True
    offline = base.with_assignments(*assignments).offline.updates

    def report(progress: Progress) -> None:
        share = progress.update / offline if progress.phase == "offline" and offline else 1.0
        on_progress(share, f"{progress.phase} {progress.update:,} of {progress.updates:,}")

    def save() -> None:
        for learner, files in work:
            learner.save(files.offline_checkpoint(agent))

    if len(seeds) > 1:
        train_together([learner for learner, _ in work], report, save)
    for learner, files in work:
        unfinished, made = files.offline_checkpoint(agent), files.checkpoint(agent, 0)
        learner.pretrain(report, partial(learner.save, unfinished))
        learner.save(made)
        unfinished.unlink(missing_ok=True)
        offline_cache.keep(learner.description, agent, made, learner.together)
    return not begun


def evaluate_offline(
    folder: ComparisonFolder, base: Description, seed: int, assignments: Sequence[str] = ()
) -> None:
    """Evaluate the team pi_0 of a seed, once for all arms that have it; see `train_offline`."""
    description = describe(base, assignments, seed)
    files = offline_files(folder, base, description)
    write_json(files.root / OFFLINE, asdict(_evaluate(restored(files, description), 0)))


def run_arm(
    folder: ComparisonFolder,
    base: Description,
    seed: int,
    arm: str,
    assignments: Sequence[str],
    versions: Mapping[str, str],
    on_progress: OnProgress,
) -> Run:
    """Tune an arm through all deployments, from the seed's offline checkpoints.

    Raises:
        UserError: a checkpoint or pi_0's evaluation is missing, damaged or of other policies.
    """
    start = time.monotonic()
    description = describe(base, assignments, seed)
    files = offline_files(folder, base, description)
    analysis = analyses.create(arm, description) if arm in ANALYSES else None
    learners = restored(files, description, analysis)
    together = sorted({seed for learner in learners for seed in learner.together})
    first = Evaluation(**read_json(files.root / OFFLINE))
    if first.policies != _digests(learners):
        raise UserError(f"{files.root / OFFLINE} is of other policies; delete it")
    evaluations, tunings = [first], []
    measured: list[Measured | None] = []
    count, h = description.deployment.count, _horizon(description)
    with TemporaryDirectory() as scratch:
        earlier = RunFolder(Path(scratch))
        for k in range(1, count + 1):

            def on_progress_of_k(share: float, where: str, k: int = k) -> None:
                on_progress((k - 1 + share) / count, f"{where} {k} of {count}")

            on_progress_of_k(0.0, "deployment")
            steps = team.deploy(learners, k)
            measured.append(_measured(steps, h))
            if description.deployment.revert:
                _revert(learners, k, measured, earlier)
            if analysis is not None:
                on_progress_of_k(0.0, "analysis of deployment")
                analysis.prepare(learners, k, steps)
            tunings.append(_tune(learners, k, steps, on_progress_of_k))
            evaluations.append(_evaluate(learners, k))
    run = Run(
        arm=arm,
        seed=seed,
        description=description.digest(),
        evaluations=evaluations,
        offline=description.offline_digest(),
        together=together,
        analysis=arm if analysis is not None else "",
        told=tunings,
        measured=measured,
        horizon=h,
        best=best_of(measured),
        assignments=list(assignments),
        processor=processor(),
        versions=dict(versions),
        seconds=round(time.monotonic() - start, 1),
    )
    run.write(folder.run(seed, arm))
    return run


def restored(
    files: RunFolder, description: Description, analysis: Analysis | None = None
) -> list[Learner]:
    """All learners of a description, holding the pi_0 in `files`. Raises UserError, as `load`."""
    learners = []
    for index, agent in enumerate(registry.team_spec(description.env.id).names):
        sampler = analysis.sampler(index) if analysis is not None else None
        learner = _learner(description, agent, sampler=sampler)
        learner.load(files.checkpoint(agent, 0))
        if learner.tuned < 0:  # pi_0 was trained without what a distance of the user's own fits
            learner.pretrain(lambda progress: None, lambda: None)
        learners.append(learner)
    return learners


def _learner(
    description: Description,
    agent: str,
    fits: Iterable[str] = (),
    sampler: Sampler | None = None,
) -> Learner:
    spec = registry.team_spec(description.env.id)
    dataset = description.dataset
    path = store.agent_file(dataset.name, agent, dataset.transitions)
    data, task = store.load_agent(path, agent), registry.task(description.env.id)
    index = spec.index(agent)
    place = (index, len(spec.agents))
    return Learner(description, spec.agents[index], data, task, place, sampler, fits)


def _horizon(description: Description) -> int:
    """Steps of an episode that count where a deployment judges its policies."""
    spec = registry.team_spec(description.env.id)
    steps = Schedule.of(description, len(spec.agents)).steps
    return horizon(steps, description.env.copies, spec.max_episode_steps)


def _measured(steps: Sequence[JointStep], h: int) -> Measured | None:
    """What a deployment said of its policies; None if too few episodes began early enough."""
    try:
        return team.measured(steps, h)
    except TooFewError:
        return None


def _revert(
    learners: Sequence[Learner],
    deployment: int,
    measured: Sequence[Measured | None],
    earlier: RunFolder,
) -> None:
    """Keep pi_{k-1} in the folder `earlier`, and take up the best deployed policy again.

    Raises:
        UserError: a deployment could not be measured.
    """
    known = [one for one in measured if one is not None]
    if len(known) < len(measured):
        raise UserError(
            f"deployment.revert needs {ENOUGH} episodes of every deployment, and deployment"
            f" {deployment} measured none: deploy longer (deployment.transitions, env.copies), or"
            " set deployment.revert=false"
        )
    best = reverted(known)
    for learner in learners:
        learner.save(earlier.checkpoint(learner.spec.name, deployment - 1))
        if best is not None:
            learner.revert(earlier.checkpoint(learner.spec.name, best))


def _tune(
    learners: Sequence[Learner],
    deployment: int,
    steps: Sequence[JointStep],
    on_progress: OnProgress,
) -> dict[str, SamplerMetrics]:
    """The tuning after deployment k: agent -> what its sampler gave before the updates."""
    tunings: dict[str, SamplerMetrics] = {}
    for index, learner in enumerate(learners):
        name = learner.spec.name
        tunings[name] = {}

        def report(progress: Progress, index: int = index, name: str = name) -> None:
            if progress.update == 0:
                tunings[name] = {
                    key: value if isfinite(value) else None
                    for key, value in progress.metrics.items()
                }
            within = progress.update / max(progress.updates, 1)
            on_progress((index + within) / len(learners), f"tuning {name} after deployment")

        learner.tune(deployment, team.own_transitions(steps, index), report)
    return tunings


def _evaluate(learners: Sequence[Learner], deployment: int) -> Evaluation:
    rollout = team.evaluate(learners, deployment)
    return Evaluation(
        list(rollout.episode_returns),
        list(rollout.episode_lengths),
        _digests(learners),
        None if rollout.successes is None else list(rollout.successes),
    )


def _digests(learners: Sequence[Learner]) -> dict[str, str]:
    return {learner.spec.name: learner.policy_digest() for learner in learners}
