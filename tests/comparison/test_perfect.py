"""Single steps played again, with the recorded actions of all agents or with others."""

import numpy as np
import pytest

from otc_dist.comparison import perfect
from otc_dist.comparison.perfect import Correction, OneStep
from otc_dist.datasets import store
from otc_dist.datasets.joint import JointTransitions
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32

SIZE = 2000


@pytest.fixture(scope="module")
def hopper() -> JointTransitions:
    return recorded("hopper-3x1/medium-replay")


def recorded(name: str) -> JointTransitions:
    store.ensure(name, SIZE)
    return store.load_joint(name, SIZE)


def worst(found: Float32, truth: Float32) -> Float32:
    """Of every transition, the error of its worst coordinate in standard deviations (N,)."""
    error: Float32 = np.abs(found - truth) / (truth.std(axis=0) + np.float32(1e-6))
    return error.max(axis=1)


def test_a_robot_played_again_does_what_was_recorded(hopper: JointTransitions) -> None:
    found = OneStep("hopper-3x1").play(hopper.observations[0], hopper.actions)
    errors = worst(found.successors[0], hopper.next_observations[0])
    assert np.median(errors) < 1e-5
    seen_whole = (np.abs(hopper.observations[0]) < 10).all(axis=1)  # no velocity was clipped
    assert 0.5 < seen_whole.mean() < 1
    assert errors[seen_whole].max() < 1e-4
    assert np.percentile(errors, 95) < 0.1
    assert np.median(np.abs(found.rewards[0] - hopper.rewards[0])) < 1e-5
    assert (found.ended == hopper.terminated).mean() > 0.999


@pytest.mark.parametrize("env_id", ["predator-prey-3", "cooperative-navigation-4"])
def test_particles_played_again_do_what_was_recorded(env_id: str) -> None:
    joint = recorded(f"{env_id}/random")
    found = OneStep(env_id).play(joint.observations[1], joint.actions)
    assert worst(found.successors[1], joint.next_observations[1]).max() < 1e-6
    assert np.array_equal(found.rewards[0], joint.rewards[0])


def test_with_the_recorded_actions_the_correction_changes_nothing(
    hopper: JointTransitions,
) -> None:
    correction = Correction(OneStep("hopper-3x1"), hopper)
    assert 0 < correction.missed.mean() < 0.5
    same, own = correction.of_agent(1, hopper.actions), hopper.of_agent(1)
    assert worst(same.next_observations, own.next_observations).max() < perfect.TOLERANCE
    assert np.abs(same.rewards - own.rewards).max() < 0.01
    assert np.array_equal(same.terminated, own.terminated)
    assert np.array_equal(same.actions, own.actions)


def test_the_others_do_otherwise_and_the_agent_what_it_did(hopper: JointTransitions) -> None:
    """Against the simulator itself, from the states in which nothing was clipped."""
    random = np.random.default_rng(0)
    now = [random.uniform(-1, 1, action.shape).astype(np.float32) for action in hopper.actions]
    simulator = OneStep("hopper-3x1")
    correction = Correction(simulator, hopper)
    found = correction.of_agent(1, now)
    expected = simulator.play(hopper.observations[1], [now[0], hopper.actions[1], now[2]])
    hit = ~correction.missed
    assert np.array_equal(found.next_observations[hit], expected.successors[1][hit])
    assert np.array_equal(found.rewards[hit], expected.rewards[1][hit])
    assert np.array_equal(found.terminated[hit], expected.ended[hit])
    assert found.terminated.sum() != hopper.terminated.sum()
    moved = worst(found.next_observations, hopper.next_observations[1])
    assert np.median(moved) > 0.1
    # Elsewhere it is the recorded step and what other actions change: nearer to it than the raw.
    missed = correction.missed
    assert (worst(expected.successors[1], found.next_observations)[missed] > 0).any()
    low, high = hopper.next_observations[1].min(axis=0), hopper.next_observations[1].max(axis=0)
    assert (
        (found.next_observations[missed] >= low) & (found.next_observations[missed] <= high)
    ).all()
    assert not (found.truncated & found.terminated).any()


@pytest.mark.parametrize("env_id", ["navigation", "5m_vs_6m"])
def test_a_state_that_cannot_be_set_is_one_clear_line(env_id: str) -> None:
    with pytest.raises(UserError, match="robots and particles have") as error:
        OneStep(env_id)
    assert "\n" not in str(error.value)
