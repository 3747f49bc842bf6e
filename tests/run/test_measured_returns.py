"""What a deployment says of its policies: no favour for short episodes, the same h everywhere."""

import numpy as np
import pytest
from numpy.typing import NDArray

from otc_dist.run import measured_returns
from otc_dist.run.measured_returns import Measured, measure
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool


def _ends(steps: int, copies: int, *where: tuple[int, int]) -> Bool:
    ends = np.zeros((steps, copies), bool)
    for step, copy in where:
        ends[step, copy] = True
    return ends


def _counted(steps: int, copies: int) -> NDArray[np.float32]:
    """A reward that tells its step: 2^step, so that a sum names its steps."""
    return np.repeat(2.0 ** np.arange(steps, dtype=np.float32)[:, None], copies, axis=1)


def test_the_first_h_steps_of_every_episode_with_room_for_them_count() -> None:
    # Copy 0: one episode of 10 steps. Copy 1: steps 0-1, 2-7, and 8-9, which has no room for 3.
    ends = _ends(10, 2, (1, 1), (7, 1))
    found = measure(_counted(10, 2), ends, np.zeros_like(ends), h=3)
    returns = [1 + 2 + 4, 1 + 2, 4 + 8 + 16]
    assert found.episodes == 3
    assert found.mean == np.mean(returns)
    assert found.error == pytest.approx(np.std(returns, ddof=1) / np.sqrt(3))


def test_an_episode_that_began_exactly_h_steps_before_the_end_counts() -> None:
    for last, episodes in ((6, 3), (7, 2)):  # the second episode of copy 0 begins at 7, at 8
        ends = _ends(10, 2, (last, 0))
        assert measure(_counted(10, 2), ends, np.zeros_like(ends), h=3).episodes == episodes


def test_a_time_limit_ends_an_episode_as_well() -> None:
    nothing, ends = _ends(10, 2), _ends(10, 2, (1, 1), (7, 1))
    rewards = _counted(10, 2)
    assert measure(rewards, nothing, ends, 3) == measure(rewards, ends, nothing, 3)


def test_an_episode_that_the_simulator_broke_off_within_h_steps_does_not_count() -> None:
    rewards = _counted(10, 2)
    early, late = _ends(10, 2, (1, 1)), _ends(10, 2, (4, 1))
    assert measure(rewards, early, early, h=3).mean == np.mean([7, 4 + 8 + 16])
    assert measure(rewards, late, late, h=3).mean == np.mean([7, 7, 32 + 64 + 128])


def test_the_completed_episodes_alone_would_favour_short_ones() -> None:
    """Of two kinds of episode, half and half, the long ones return more, and rarely complete."""
    random, steps, copies, h = np.random.default_rng(0), 400, 512, 100
    ends = np.zeros((steps, copies), bool)
    for copy in range(copies):
        start = 0
        while start < steps:
            start += 5 if random.random() < 0.5 else 300
            if start <= steps:
                ends[start - 1, copy] = True
    rewards = np.ones((steps, copies), np.float32)
    truth = (5 + h) / 2
    found = measure(rewards, ends, np.zeros_like(ends), h)
    assert abs(found.mean - truth) < 4 * found.error
    assert found.error < 2
    completed = []
    for copy in range(copies):
        marks = np.flatnonzero(ends[:, copy]) + 1
        completed += list(np.diff(marks, prepend=0))
    assert abs(np.mean(np.minimum(completed, h)) - truth) > 5 * found.error


@pytest.mark.parametrize("last", [None, 8])
def test_fewer_than_two_episodes_are_refused_in_one_line(last: int | None) -> None:
    ends = _ends(10, 1, *([] if last is None else [(last, 0)]))
    with pytest.raises(
        UserError, match=r"2 episodes that began 5 steps .* it holds 1: deploy"
    ) as e:
        measure(_counted(10, 1), ends, np.zeros_like(ends), h=5)
    assert "\n" not in str(e.value)


def test_two_are_enough() -> None:
    ends = _ends(10, 1, (4, 0))
    assert measure(_counted(10, 1), ends, np.zeros_like(ends), h=5).episodes == 2


def test_h_is_the_deployment_or_the_longest_episode() -> None:
    assert measured_returns.horizon(500, 4, 1000) == 500
    assert measured_returns.horizon(500, 4, 100) == 100
    assert (
        measured_returns.horizon(500, 1, 1000) == 250
    )  # room for a second episode of a single copy
    assert measured_returns.horizon(1, 1, 100) == 1


@pytest.mark.parametrize(
    ("steps", "copies", "longest", "certain", "possible"),
    [
        (100, 2, 1000, True, True),  # two copies have two first episodes
        (100, 1, 1000, False, True),  # the first may last for ever
        (100, 1, 50, True, True),  # the second begins in time
        (100, 1, 51, False, True),
        (1, 1, 50, False, False),
        (1, 2, 50, True, True),
    ],
)
def test_what_can_be_known_before_a_deployment(
    steps: int, copies: int, longest: int, certain: bool, possible: bool
) -> None:
    assert measured_returns.certain(steps, copies, longest) is certain
    assert measured_returns.possible(steps, copies) is possible
    # The policy under which the fewest episodes begin, and the one under which the most do.
    h, nothing = measured_returns.horizon(steps, copies, longest), np.zeros((steps, copies), bool)
    for every, enough in ((longest, certain), (1, possible)):
        ends = nothing.copy()
        ends[every - 1 :: every] = True
        try:
            measure(np.ones((steps, copies), np.float32), ends, nothing, h)
        except UserError:
            assert not enough
        else:
            assert enough


def test_rewards_that_differ_are_noticed_and_averaged() -> None:
    mine, other = np.float32([[1, 2]]), np.float32([[1, 4]])
    assert measured_returns.alike([mine, mine.copy(), mine.copy()])
    assert not measured_returns.alike([mine, mine, other])
    third = np.float32([[0.1, 0.7]])  # whose mean of three is another number in float32
    assert measured_returns.team_rewards([third] * 3).tobytes() == third.tobytes()
    assert measured_returns.team_rewards([mine, other]).tolist() == [[1, 3]]


def test_the_first_of_equals_is_best() -> None:
    found = [Measured(mean, 1.0, 4) for mean in (3.0, 5.0, 5.0, 4.0)]
    assert measured_returns.best(found) == 2
