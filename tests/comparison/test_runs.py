import errno
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from otc_dist.comparison import runs
from otc_dist.comparison.arms import KNOWN, NULL, REFERENCE, Arms, describe, parse_arms
from otc_dist.comparison.score_statistics import summarise
from otc_dist.comparison.scores import ComparisonFolder, Run, best_of
from otc_dist.description import Description, user_code
from otc_dist.learner import checkpoint, learner, team
from otc_dist.learner.learner import Learner
from otc_dist.run.measured_returns import Measured, TooFewError
from otc_dist.system.processor import processor
from otc_dist.terminal.errors import UserError

from .. import toys
from .conftest import SEEDS, VERSIONS, silent


@pytest.fixture
def scores(finished: ComparisonFolder, arms: Arms) -> dict[tuple[int, str], Run]:
    return {(seed, arm): Run.read(finished.run(seed, arm)) for seed in SEEDS for arm in arms}


def test_a_file_a_run_holds_all_raw_scores(
    scores: dict[tuple[int, str], Run], base: Description
) -> None:
    for (seed, arm), run in scores.items():
        assert (run.seed, run.arm) == (seed, arm)
        assert run.description == describe(base, run.assignments, seed).digest()
        assert run.versions == VERSIONS and run.seconds > 0
        assert len(run.evaluations) == base.deployment.count + 1
        for evaluation in run.evaluations:
            assert len(evaluation.returns) == len(evaluation.lengths) == base.evaluation.episodes
            assert set(evaluation.policies) == {"agent_0", "agent_1", "agent_2"}
        assert run.processor == processor()
        assert run.offline == describe(base, run.assignments, seed).offline_digest()
        assert len(run.told) == base.deployment.count
        alphas = {"alpha", "similarity"} if arm == "otc-embedding" else set()
        assert all(alphas == set(of) - {"guarded"} for told in run.told for of in told.values())


def test_every_deployment_judges_the_policies_that_acted_in_it(
    finished: ComparisonFolder, scores: dict[tuple[int, str], Run], base: Description
) -> None:
    steps = base.deployment.transitions // base.env.copies
    for run in scores.values():
        assert run.horizon == steps  # so only the first episode of every copy counts
        assert len(run.measured) == base.deployment.count
        means = [one.mean if one else np.nan for one in run.measured]
        assert run.best == 1 + int(np.argmax(means))
    deployed = team.deploy(runs.restored(finished.seed(0), describe(base, KNOWN[REFERENCE], 0)), 1)
    rewards = np.array([step.rewards[0] for step in deployed], np.float64)
    ends = np.array([step.terminated | step.truncated for step in deployed])
    over = np.where(ends.any(axis=0), ends.argmax(axis=0) + 1, steps)
    returns = [rewards[:stop, copy].sum() for copy, stop in enumerate(over)]
    found = scores[0, REFERENCE].measured[0]
    assert found is not None and found.episodes == len(returns)
    assert found.mean == pytest.approx(np.mean(returns))


def test_a_deployment_that_cannot_be_measured_recommends_nothing() -> None:
    some = Measured(1.0, 0.1, 4)
    assert best_of([some, Measured(2.0, 0.1, 4), some]) == 2
    assert best_of([some, None]) is None and best_of([]) is None


def test_arms_of_a_seed_share_pi_0_and_seeds_do_not(scores: dict[tuple[int, str], Run]) -> None:
    firsts = {
        seed: [r.evaluations[0] for (s, _), r in scores.items() if s == seed] for seed in SEEDS
    }
    for first in firsts.values():
        assert all(evaluation == first[0] for evaluation in first)
    assert firsts[0][0].policies != firsts[1][0].policies


def test_every_arm_tunes_in_its_own_way(scores: dict[tuple[int, str], Run]) -> None:
    tuned = [run.evaluations[-1].policies["agent_0"] for run in scores.values()]
    assert len(set(tuned)) == len(tuned)


def test_repeating_a_run_reproduces_its_scores(
    finished: ComparisonFolder,
    base: Description,
    scores: dict[tuple[int, str], Run],
    tmp_path: Path,
) -> None:
    again = ComparisonFolder(tmp_path)
    again.seed(0).root.parent.mkdir()
    again.seed(0).root.symlink_to(finished.seed(0).root)
    found = runs.run_arm(again, base, 0, "copy", KNOWN[REFERENCE], VERSIONS, silent)
    expected = scores[0, REFERENCE]
    assert replace(found, seconds=expected.seconds, arm=REFERENCE) == expected
    assert found.evaluations[1] != scores[0, NULL].evaluations[1]
    finished.run(0, "copy").unlink()


def test_an_arm_may_be_a_sampling_strategy_of_the_users_own(
    finished: ComparisonFolder, base: Description, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(user_code, "_allowed", set())
    shutil.copy(toys.__file__, tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    own = ["recent=sampling.name=toys:Recent,sampling.span=100"]
    arms = parse_arms("uniform", own)
    assert describe(base, arms["recent"], 0).sampling.model_dump()["span"] == 100
    tuned = runs.run_arm(finished, base, 0, "recent", arms["recent"], VERSIONS, silent)
    assert tuned.evaluations[1].policies != tuned.evaluations[0].policies
    finished.run(0, "recent").unlink()
    # A comparison of such a strategy holds the others against it.
    chosen = base.with_assignments(*arms["recent"])
    assert describe(chosen, arms[REFERENCE], 0) == describe(base, arms[REFERENCE], 0)


def test_interrupted_offline_training_goes_on_to_the_same_policy(
    base: Description, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    longer = base.with_assignments("offline.updates=230")
    monkeypatch.setattr(learner, "SAVE_EVERY", 100)

    def interrupt(share: float, where: str) -> None:
        if where.startswith("offline 200"):
            raise KeyboardInterrupt

    folders = [ComparisonFolder(tmp_path / name) for name in ("through", "cut")]
    assert runs.train_offline(folders[0], longer, (0,), "agent_1", silent)
    with pytest.raises(KeyboardInterrupt):
        runs.train_offline(folders[1], longer, (0,), "agent_1", interrupt)
    assert folders[1].seed(0).offline_checkpoint("agent_1").exists()
    seen: list[str] = []
    assert not runs.train_offline(
        folders[1], longer, (0,), "agent_1", lambda share, where: seen.append(where)
    )
    assert seen[0] == "offline 200 of 230"  # it had been saved after 100
    through, cut = (checkpoint.read(f.seed(0).checkpoint("agent_1", 0))[0] for f in folders)
    assert checkpoint.digest(through) == checkpoint.digest(cut)
    assert not folders[1].seed(0).offline_checkpoint("agent_1").exists()


def test_a_finished_run_is_known_by_its_description(
    finished: ComparisonFolder, base: Description
) -> None:
    digest = describe(base, KNOWN[REFERENCE], 0).digest()
    assert finished.finished(0, REFERENCE, digest) is not None
    assert finished.finished(0, "otc-value", digest) is None
    with pytest.raises(UserError, match="of another description"):
        finished.finished(0, REFERENCE, "0" * 16)


def test_scores_of_other_policies_are_refused(
    finished: ComparisonFolder, base: Description, tmp_path: Path
) -> None:
    mixed = ComparisonFolder(tmp_path)
    mixed.seed(0).root.mkdir(parents=True)
    mixed.seed(0).agent("").symlink_to(finished.seed(0).agent(""))
    mixed.offline(0).write_text(finished.offline(1).read_text())
    with pytest.raises(UserError, match="of other policies"):
        runs.run_arm(mixed, base, 0, "uniform", KNOWN[REFERENCE], VERSIONS, silent)


@pytest.mark.parametrize(
    "own", [("algorithm.discount=0.5", *KNOWN[REFERENCE]), KNOWN["typical-offline"]]
)
def test_an_arm_that_trains_otherwise_begins_from_its_own_pi_0(
    own: tuple[str, ...],
    finished: ComparisonFolder,
    base: Description,
    scores: dict[tuple[int, str], Run],
) -> None:
    for agent in ("agent_0", "agent_1", "agent_2"):
        runs.train_offline(finished, base, (0,), agent, silent, own)
    runs.evaluate_offline(finished, base, 0, own)
    before = finished.offline(0).read_bytes()
    found = runs.run_arm(finished, base, 0, "greedy", own, VERSIONS, silent)
    finished.run(0, "greedy").unlink()
    shared = scores[0, REFERENCE]
    assert finished.offline(0).read_bytes() == before
    assert found.offline != shared.offline
    assert found.evaluations[0].policies != shared.evaluations[0].policies
    summary = summarise({REFERENCE: [shared], "greedy": [found]}, lambda value: None)
    assert [arm.own_pi_0 for arm in summary.arms] == [False, True]


def test_tuning_goes_back_to_the_best_policy_where_it_is_asked_to(
    finished: ComparisonFolder, base: Description, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimates = iter([Measured(2.0, 0.1, 4), Measured(1.0, 0.1, 4)])
    monkeypatch.setattr(team, "measured", lambda steps, h: next(estimates))
    begun: list[dict[str, str]] = []
    tune = Learner.tune

    def noticed(learner: Learner, k: int, *rest: Any) -> None:
        begun.append({learner.spec.name: learner.policy_digest()})
        tune(learner, k, *rest)

    monkeypatch.setattr(Learner, "tune", noticed)
    assignments = (*KNOWN[REFERENCE], "deployment.revert=true")
    found = runs.run_arm(finished, base, 0, "back", assignments, VERSIONS, silent)
    finished.run(0, "back").unlink()
    assert found.best == 1
    first = found.evaluations[0].policies
    assert all({name: first[name]} == one for name, one in zip(first, begun[3:], strict=True))
    assert found.evaluations[1].policies != first


def test_a_deployment_that_measures_nothing_to_go_back_by_is_one_line(
    finished: ComparisonFolder, base: Description, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(steps: object, h: int) -> None:
        raise TooFewError("too few")

    monkeypatch.setattr(team, "measured", nothing)
    assignments = (*KNOWN[REFERENCE], "deployment.revert=true")
    with pytest.raises(UserError, match=r"deployment 1 measured none.*deployment\.revert=false"):
        runs.run_arm(finished, base, 0, "back", assignments, VERSIONS, silent)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("measured", []),
        ("measured", [{"mean": 1.0}, None]),
        ("best", 3),
        ("evaluations", [{"returns": [], "lengths": [], "policies": {}}] * 3),
        ("format", 1),
        ("surplus", 0),
    ],
)
def test_scores_that_no_run_can_have_are_refused(
    finished: ComparisonFolder, tmp_path: Path, field: str, value: object
) -> None:
    fields = json.loads(finished.run(0, REFERENCE).read_text())
    path = tmp_path / "uniform.json"
    path.write_text(json.dumps(fields))
    assert Run.read(path) == Run.read(finished.run(0, REFERENCE))
    path.write_text(json.dumps({**fields, field: value}))
    with pytest.raises(UserError, match=r"uniform\.json"):
        Run.read(path)
    path.write_text(json.dumps({key: item for key, item in fields.items() if key != field}))
    if field != "surplus":
        with pytest.raises(UserError, match=r"uniform\.json"):
            Run.read(path)


@pytest.mark.parametrize("content", ["", "[]", "{", json.dumps({"arm": "uniform"})])
def test_a_damaged_file_is_one_clear_line(tmp_path: Path, content: str) -> None:
    path = tmp_path / "uniform.json"
    path.write_text(content)
    with pytest.raises(UserError, match=r"uniform\.json"):
        Run.read(path)


def test_a_full_disk_is_one_clear_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(UserError, match=r"cannot write .*uniform\.json: No space left"):
        Run("uniform", 0, "", []).write(tmp_path / "uniform.json")
    assert list(tmp_path.iterdir()) == []
