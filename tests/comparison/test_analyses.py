"""Arms that look at everybody: what they hand to the learners, and what they leave alone."""

import numpy as np
import pytest
import torch
from torch import Tensor

from otc_dist.comparison import analyses, runs
from otc_dist.comparison.analyses import Analysis
from otc_dist.comparison.arms import ANALYSES, ORACLE, PERFECT, check, describe, parse_arms
from otc_dist.comparison.present import packed, would_do
from otc_dist.comparison.scores import ComparisonFolder, Run
from otc_dist.datasets import store
from otc_dist.datasets.joint import JointTransitions
from otc_dist.description import Description
from otc_dist.learner import team
from otc_dist.learner.learner import Learner
from otc_dist.otc.data import Data
from otc_dist.otc.samplers.interface import Extent, MergedData, Sampler
from otc_dist.steps.engine import Engine
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32

from .conftest import VERSIONS, silent

POOL = 300


class Prepared:
    """An analysis that has looked at the first deployment."""

    def __init__(self, name: str, finished: ComparisonFolder, base: Description) -> None:
        description = describe(base, ANALYSES[name], 0)
        self.analysis: Analysis = analyses.create(name, description)
        files = finished.seed(0)
        self.learners: list[Learner] = runs.restored(files, description, self.analysis)
        steps = team.deploy(self.learners, 1)
        self.analysis.prepare(self.learners, 1, steps)
        offline = store.load_joint(base.dataset.name, base.dataset.transitions)
        online = JointTransitions.of_steps(steps)
        self.joint = JointTransitions.concatenate([offline, online])
        self.extent = Extent(len(offline), len(offline), len(self.joint))
        own = team.own_transitions(steps, 1)
        assert np.array_equal(own.actions, online.of_agent(1).actions)

    def sampled(self, sampler: Sampler, rows: Tensor) -> tuple[Data, Tensor, Tensor]:
        """The data an update is given, and many chosen row numbers, for values and to imitate."""
        _, state = self.learners[1].policy
        data = Data(rows, rows[:, :0])
        random = np.random.default_rng(0)
        begun = sampler.begin(
            MergedData(state, data, self.extent, Engine("eager"), lambda *key: random)
        ).data
        drawn = sampler.sample_indices(random, 50, self.extent)
        chosen = []
        for update in range(50):
            sampled = {name: torch.from_numpy(array[update]) for name, array in drawn.items()}
            chosen.append(sampler.select(state, sampler.gather(state, begun, sampled), sampled))
        return (
            begun,
            torch.cat([one.rows for one in chosen]),
            torch.cat([one.imitated for one in chosen]),
        )


def test_perfect_correction_feeds_values_and_leaves_imitation_alone(
    finished: ComparisonFolder, base: Description, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(analyses, "POOL", POOL)
    one = Prepared(PERFECT, finished, base)
    spec, size = one.learners[1].spec, one.extent.size
    rows = packed(spec, one.joint.of_agent(1))
    data, values, imitated = one.sampled(one.analysis.sampler(1), rows)
    assert torch.equal(data.rows[:size], rows) and len(data.rows) == size + POOL
    assert values.min() >= size and len(values.unique()) > 0.9 * POOL
    assert imitated.max() < size and len(imitated.unique()) > size / 2
    # Every made row has the (s, a_i) of a recorded one, and most have another s'.
    head = spec.observation_size + spec.action_size
    recorded = {tuple(row[:head].tolist()): row for row in rows}
    made = data.rows[size:]
    changed = [(row - recorded[tuple(row[:head].tolist())]).abs().max() > 1e-3 for row in made]
    assert 0.9 < np.mean(changed) < 1  # not those of the newest deployment


def test_the_oracle_knows_how_far_the_others_are(
    finished: ComparisonFolder, base: Description, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(learner: Learner, observations: Float32, random: np.random.Generator) -> Float32:
        return np.zeros((len(observations), learner.spec.action_size), np.float32)

    monkeypatch.setattr(analyses, "would_do", nothing)
    one = Prepared(ORACLE, finished, base)
    rows = packed(one.learners[1].spec, one.joint.of_agent(1))
    _, values, imitated = one.sampled(one.analysis.sampler(1), rows)
    others = np.hypot(one.joint.actions[0][:, 0], one.joint.actions[2][:, 0])
    best = set(others.argsort(kind="stable")[: -(-len(others) // 10)].tolist())
    newest = set(range(one.extent.newest, one.extent.size))
    assert set(values.tolist()) <= best | newest and len(values.unique()) > 0.9 * len(best)
    assert len(imitated.unique()) > one.extent.size / 2


def test_what_an_agent_would_do_is_what_it_does(
    finished: ComparisonFolder, base: Description
) -> None:
    """In states of the deployment: nearer to what it did there than in other states."""
    description = describe(base, ("sampling.name=uniform",), 0)
    learners = runs.restored(finished.seed(0), description)
    steps = JointTransitions.of_steps(team.deploy(learners, 1))
    random = np.random.default_rng
    now = would_do(learners[0], steps.observations[0], random(0))
    assert now.shape == steps.actions[0].shape and np.abs(now).max() <= 1
    assert np.array_equal(now, would_do(learners[0], steps.observations[0], random(0)))
    there = np.abs(now - steps.actions[0]).mean()
    assert there < 0.9 * np.abs(now - np.roll(steps.actions[0], 40, axis=0)).mean()


@pytest.mark.parametrize("name", list(ANALYSES))
def test_an_analysis_is_an_arm_like_any_other(
    name: str,
    finished: ComparisonFolder,
    base: Description,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(analyses, "POOL", POOL)
    runs.run_arm(finished, base, 0, name, ANALYSES[name], VERSIONS, silent)
    found, uniform = (Run.read(finished.run(0, arm)) for arm in (name, "uniform"))
    finished.run(0, name).unlink()
    assert (found.analysis, uniform.analysis) == (name, "")
    assert found.evaluations[0] == uniform.evaluations[0]
    assert found.measured[0] == uniform.measured[0]
    assert found.evaluations[1].policies != uniform.evaluations[1].policies
    again = runs.run_arm(finished, base, 0, name, ANALYSES[name], VERSIONS, silent)
    finished.run(0, name).unlink()
    assert again.evaluations == found.evaluations
    plain = runs.run_arm(finished, base, 0, "plain", ANALYSES[name], VERSIONS, silent)
    finished.run(0, "plain").unlink()
    assert plain.evaluations[1].policies != found.evaluations[1].policies


@pytest.mark.parametrize(
    ("name", "change", "expected"),
    [
        (PERFECT, "env.id=hopper-1x3", "about other agents, and hopper-1x3 has none"),
        (ORACLE, "deployment.exploration=sequential", "exploration = 'none'"),
    ],
)
def test_an_analysis_that_cannot_be_made_is_one_clear_line(
    base: Description, name: str, change: str, expected: str
) -> None:
    with pytest.raises(UserError, match=f"arm {name}: .*{expected}"):
        arms = parse_arms(name)
        check(base.with_assignments(change, "deployment.keep=last"), arms)
