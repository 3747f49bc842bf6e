"""How a learner acts: a pure function of its policy, within the bounds of the agent."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from otc_dist.algorithms.bcq import Bcq

from ..brains import (
    ARMS,
    SPEC,
    brain,
    finished,
    pretrained,
    transitions,
)

pytestmark = pytest.mark.usefixtures("small_blocks")
OBSERVATIONS = transitions(7, 3).observations


def test_acting_is_a_pure_function() -> None:
    learner = pretrained(*ARMS["uniform"])
    digest = learner.policy_digest()
    first = learner.act(OBSERVATIONS, "deployment", 1, 5)
    others = [
        learner.act(OBSERVATIONS, "deployment", 1, 6),
        learner.act(OBSERVATIONS, "deployment", 2, 5),
        learner.act(OBSERVATIONS, "evaluation", 1, 5),
    ]
    again = learner.act(OBSERVATIONS.copy(), "deployment", 1, 5)
    assert first.tobytes() == again.tobytes()
    assert first.shape == (3, 2) and first.dtype == np.float32
    assert learner.policy_digest() == digest
    for other in others:
        assert not np.array_equal(first, other)


def test_acting_does_not_disturb_tuning(tmp_path: Path) -> None:
    quiet, busy = pretrained(*ARMS["otc-value"]), pretrained(*ARMS["otc-value"])
    for step in range(3):
        busy.act(OBSERVATIONS, "deployment", 1, step)
    assert finished(quiet, tmp_path / "quiet") == finished(busy, tmp_path / "busy")


def test_agents_of_one_seed_draw_different_numbers() -> None:
    first = pretrained(*ARMS["uniform"])
    second = pretrained(*ARMS["uniform"], spec=replace(SPEC, name="agent_1"))
    assert first.policy_digest() != second.policy_digest()


def test_actions_are_scaled_to_asymmetric_bounds() -> None:
    """Behaviour that always does the same is imitated, in the environment's units."""
    data = transitions(0, 200)
    data.actions[:] = (0.22, -0.6)
    fast = ("algorithm.vae_learning_rate=0.01", "offline.updates=300", "algorithm.perturbation=0")
    learner = pretrained(*ARMS["uniform"], *fast, data=data)
    actions = learner.act(OBSERVATIONS, "deployment", 1, 0)
    error = np.abs(actions - [0.22, -0.6]) / (0.2, 2.0)  # of half the range
    assert error.max() < 0.1


@pytest.mark.parametrize("extreme", [-1.0, 1.0])
def test_actions_never_leave_the_bounds(extreme: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not by rounding either: in float32 the scaled 1 lies above 0.7, the scaled -1 below -0.7."""
    spec = replace(SPEC, action_low=(-0.1, -0.7), action_high=(0.7, 0.1))
    learner = brain(*ARMS["uniform"], spec=spec)
    monkeypatch.setattr(Bcq, "act", lambda *_: torch.full((3, 2), extreme))
    actions = learner.act(OBSERVATIONS, "deployment", 1, 0)
    expected = np.array(spec.action_low if extreme < 0 else spec.action_high, np.float32)
    assert (actions >= np.float32(spec.action_low)).all()
    assert (actions <= np.float32(spec.action_high)).all()
    np.testing.assert_allclose(actions, np.broadcast_to(expected, (3, 2)), rtol=1e-6)
