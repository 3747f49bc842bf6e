"""Halves of a data set by whole episodes."""

import numpy as np

from otc_dist.learner.folds import episodes, folds
from otc_dist.transitions import Transitions


def played(lengths: list[int], last: str = "truncated") -> Transitions:
    """Episodes one after another; each ends, but for the last of them if `last` is "cut"."""
    random, parts = np.random.default_rng(0), []
    for number, length in enumerate(lengths):
        states = random.standard_normal((length + 1, 3)).astype(np.float32)
        no = np.zeros(length, np.bool_)
        terminated, truncated = no.copy(), no.copy()
        if number < len(lengths) - 1 or last != "cut":
            (terminated if number % 2 else truncated)[-1] = True
        one = np.zeros((length, 1), np.float32)
        parts.append(Transitions(states[:-1], one, one[:, 0], states[1:], terminated, truncated))
    return Transitions.concatenate(parts)


def test_episodes_are_numbered_in_order() -> None:
    found = episodes(played([3, 1, 4]))
    assert found.tolist() == [0, 0, 0, 1, 2, 2, 2, 2]


def test_episodes_side_by_side_are_told_apart() -> None:
    """As deployments have them: a row of every copy at each step."""
    data = played([4, 4])
    interleaved = data[np.array([0, 4, 1, 5, 2, 6, 3, 7])]
    assert episodes(interleaved).tolist() == [0, 1] * 4
    assert folds(interleaved).tolist() == [0, 1] * 4


def test_no_episode_is_in_both_halves() -> None:
    data = played([5, 3, 6, 2, 4, 1])
    number, half = episodes(data), folds(data)
    for episode in range(6):
        assert len(set(half[number == episode])) == 1
    assert set(half) == {0, 1}


def test_a_single_episode_is_cut_in_the_middle() -> None:
    assert folds(played([6], last="cut")).tolist() == [0, 0, 0, 1, 1, 1]
