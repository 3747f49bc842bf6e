"""Where a learner keeps its own transitions: `otc_dist.learner.experience`."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from otc_dist.learner.action_scale import ActionScale
from otc_dist.learner.experience import Experience
from otc_dist.otc.distances.interface import Report
from otc_dist.otc.samplers.interface import Extent, Random
from otc_dist.spec import AgentSpec
from otc_dist.transitions import RowLayout
from tests.brains import transitions

SPEC = AgentSpec("agent_0", 3, (-2.0, 0.0), (2.0, 1.0))
LAYOUT = RowLayout(3, 2)


class Sums:
    """The sum of each row as its only feature, times a factor that is fit."""

    name, size, updates, state = "sums", 1, 0, None

    def __init__(self) -> None:
        self.factor = 0.0

    def fit(self, rows: Tensor, folds: Tensor, random: Random, report: Report) -> None:
        self.factor = 1.0

    def embed(self, rows: Tensor, folds: Tensor, out: Tensor) -> None:
        out[:] = self.factor * rows.sum(1, keepdim=True)


def experience(features: Sums | None) -> Experience:
    offline = transitions(0, 20, SPEC)
    return Experience(LAYOUT, ActionScale(SPEC), offline, 12, features, torch.device("cpu"))


def test_deployments_follow_the_offline_data_with_actions_scaled_to_one() -> None:
    own, newest = experience(None), transitions(2, 5, SPEC)
    assert (own.extent, own.capacity, own.offline.shape) == (
        Extent(20, 0, 20),
        32,
        (20, LAYOUT.width),
    )
    own.merge(transitions(1, 4, SPEC))
    own.merge(newest)
    assert own.extent == Extent(20, 24, 29)
    rows = own.data.rows[24:29].numpy()
    np.testing.assert_array_equal(rows[:, LAYOUT.observation], newest.observations)
    scaled = newest.actions / (2, 0.5) - (0, 1)
    np.testing.assert_allclose(rows[:, LAYOUT.action], scaled, atol=1e-6)
    assert own.data.features.shape == (32, 0)


def test_every_transition_has_its_features() -> None:
    """Those of a deployment as it comes, and all anew when the features have been fit."""
    features = Sums()
    own = experience(features)
    assert not own.data.features.any()
    features.factor = 1.0
    own.embed()
    own.merge(transitions(1, 4, SPEC))
    assert torch.equal(own.data.features[:24], own.data.rows[:24].sum(1, keepdim=True))


def test_a_step_that_did_not_happen_is_not_kept() -> None:
    own, newest = experience(None), transitions(1, 4, SPEC)
    newest.terminated[2] = newest.truncated[2] = True
    newest.rewards[2] = 1e6
    own.merge(newest)
    assert own.data.rows[20:24, LAYOUT.reward].max() < 1e6


def test_what_does_not_fit_or_is_not_finite_is_refused_and_changes_nothing() -> None:
    own, good = experience(None), transitions(1, 2, SPEC)
    nan = replace(good, rewards=np.array([1.0, np.nan], np.float32))
    thin = replace(good, observations=good.observations[:, :1])
    many = transitions(1, 13, SPEC)
    for bad, expected in (
        (many, "33 transitions do not fit into 32 rows"),
        (nan, "finite"),
        (thin, "sizes"),
    ):
        with pytest.raises(ValueError, match=expected):
            own.merge(bad)
        assert own.extent == Extent(20, 0, 20)
    own.merge(good)
    assert own.extent == Extent(20, 20, 22)
