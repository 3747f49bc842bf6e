"""The data that flow: what an agent may see of a joint step, and where it keeps it."""

from dataclasses import replace

import numpy as np
import pytest

from otc_dist.transitions import JointStep, RowLayout, Transitions

from .brains import transitions

LAYOUT = RowLayout(5, 2)


def joint_step(copies: int = 3) -> JointStep:
    def block(agent: int, width: int) -> np.ndarray:
        values = np.arange(copies * width, dtype=np.float32).reshape(copies, width)
        return values + 100 * agent

    return JointStep(
        step=4,
        observations=tuple(block(i, 5) for i in range(2)),
        actions=tuple(block(i, 2) for i in range(2)),
        rewards=tuple(block(i, 1)[:, 0] for i in range(2)),
        next_observations=tuple(block(i, 5) + 0.5 for i in range(2)),
        terminated=np.array([True, False, False]),
        truncated=np.array([False, True, False]),
        exploring=(False, False),
        episode_seeds=np.arange(copies),
        state=np.zeros((copies, 4)),
    )


def test_an_agent_sees_its_own_part_of_a_joint_step() -> None:
    step = joint_step()
    own = step.of_agent(1)
    assert len(own) == 3
    for name in ("observations", "actions", "rewards", "next_observations"):
        assert getattr(own, name) is getattr(step, name)[1]
        assert (getattr(own, name) >= 100).all()  # nothing of agent 0
    assert own.terminated.tolist() == [True, False, False]
    assert own.truncated.tolist() == [False, True, False]


def test_slices_and_concatenation_are_inverse() -> None:
    whole = transitions(0, 10)
    again = Transitions.concatenate([whole[:3], whole[3:4], whole[4:]])
    for name in whole.__dataclass_fields__:
        assert np.array_equal(getattr(again, name), getattr(whole, name))
    picked = whole[np.array([7, 7, 1])]
    assert np.array_equal(picked.rewards, whole.rewards[[7, 7, 1]])


def test_a_row_holds_every_field_once() -> None:
    parts = [LAYOUT.observation, LAYOUT.action, LAYOUT.next_observation]
    columns = [c for part in parts for c in range(LAYOUT.width)[part]]
    assert sorted([*columns, LAYOUT.reward, LAYOUT.terminated]) == list(range(LAYOUT.width))


def test_packed_rows_hold_what_was_given() -> None:
    whole = transitions(0, 10)
    rows = LAYOUT.pack(whole)
    assert np.array_equal(rows[:, LAYOUT.observation], whole.observations)
    assert np.array_equal(rows[:, LAYOUT.action], whole.actions)
    assert np.array_equal(rows[:, LAYOUT.reward], whole.rewards)
    assert np.array_equal(rows[:, LAYOUT.next_observation], whole.next_observations)
    assert np.array_equal(rows[:, LAYOUT.terminated], whole.terminated)  # not where truncated
    some = np.zeros((12, LAYOUT.width), np.float32)
    assert np.array_equal(LAYOUT.pack(whole, some[1:11]), rows)
    assert np.array_equal(some[1:11], rows) and not some[[0, 11]].any()


def test_rows_of_steps_that_did_not_happen_are_replaced() -> None:
    data = transitions(0, 6)
    assert data.sound() is data
    broken = np.array([True, False, True, True, False, False])
    found = replace(data, terminated=data.terminated | broken, truncated=broken).sound()
    np.testing.assert_array_equal(found.rewards, data.rewards[[1, 1, 1, 1, 4, 5]])
    assert not (found.terminated & found.truncated).any()
    with pytest.raises(ValueError, match="in every step"):
        replace(data, terminated=broken | True, truncated=broken | True).sound()
