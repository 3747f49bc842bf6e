"""Learners pretrain, act and tune with CQL: continuous, and discrete with masks."""

import numpy as np
import pytest

from otc_dist.description import Description
from otc_dist.learner.learner import Learner, Progress
from otc_dist.spec import AgentSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Transitions

from .. import brains

CHOICES = 5
DISCRETE = AgentSpec("agent_0", 4 + CHOICES, (0.0,), (CHOICES - 1.0,), choices=CHOICES)
DISTANCES = tuple(
    f"sampling.distance={name}" for name in ("embedding", "value", "dynamics", "typical")
)


def masked(seed: int, count: int) -> Transitions:
    """Random data of the discrete agent: about half of the actions available, one at least."""
    random = np.random.default_rng(seed)
    states = random.standard_normal((2, count, DISCRETE.observation_size)).astype(np.float32)
    masks = random.random((2, count, CHOICES)) < 0.5
    masks[..., 0] |= ~masks.any(-1)
    states[..., -CHOICES:] = masks
    terminated = random.random(count) < 0.05
    states[1, terminated, -CHOICES:] = 0  # nothing is left to choose
    actions = np.where(masks[0], random.random(masks[0].shape), -1).argmax(1)
    return Transitions(
        observations=states[0],
        actions=actions[:, None].astype(np.float32),
        rewards=states[0, :, 0],
        next_observations=states[1],
        terminated=terminated,
        truncated=np.zeros(count, np.bool_),
    )


def make(
    algorithm: dict[str, object], spec: AgentSpec, data: Transitions, *assignments: str
) -> Learner:
    section = {"hidden": [8, 8], "batch_size": 16, **algorithm}
    description = Description.build({**brains.SMALL, "algorithm": section}, assignments)
    return Learner(description, spec, data)


def tuned(learner: Learner, deployments: list[Transitions]) -> list[Progress]:
    """Pretrain and tune; what was reported."""
    reports: list[Progress] = []
    learner.pretrain(reports.append, brains.unsaved)
    for k, data in enumerate(deployments, start=1):
        learner.tune(k, data, reports.append)
    return reports


@pytest.mark.parametrize("distance", DISTANCES)
def test_continuous(distance: str) -> None:
    data = brains.transitions(0, 200)
    learner = make({"name": "cql", "action_samples": 3}, brains.SPEC, data, distance)
    reports = tuned(learner, [brains.online(1), brains.online(2)])
    assert learner.tuned == 2
    assert all(np.isfinite(list(report.metrics.values())).all() for report in reports)
    observations = brains.transitions(7, 6).observations
    actions = learner.act(observations, "evaluation", 2, 0)
    low, high = brains.SPEC.action_low, brains.SPEC.action_high
    assert actions.shape == (6, 2)
    assert (low <= actions).all() and (actions <= high).all()


@pytest.mark.parametrize("distance", DISTANCES)
def test_discrete(distance: str) -> None:
    learner = make({"name": "discrete-cql"}, DISCRETE, masked(0, 200), distance)
    reports = tuned(learner, [masked(1, brains.ONLINE), masked(2, brains.ONLINE)])
    assert learner.tuned == 2
    assert all(np.isfinite(list(report.metrics.values())).all() for report in reports)
    observations = masked(7, 30).observations
    actions = learner.act(observations, "evaluation", 2, 0)
    assert actions.shape == (30, 1)
    chosen = actions[:, 0].astype(int)
    assert (observations[np.arange(30), 4 + chosen] == 1).all()


def test_masks_without_an_available_action_are_refused_in_data_and_in_observations() -> None:
    data = masked(0, 200)
    learner = make({"name": "discrete-cql"}, DISCRETE, data)
    data.observations[3, -CHOICES:] = 0
    with pytest.raises(ValueError, match="row 3 has no available action"):
        make({"name": "discrete-cql"}, DISCRETE, data)
    with pytest.raises(UserError, match="agent_0 has no available action"):
        learner.act(data.observations[2:5], "evaluation", 0, 0)
