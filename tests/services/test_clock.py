"""The clock of deployments in real time, by a time that the tests make."""

import pytest

from otc_dist.services.clock import Clock, Misses

PERIOD = 1 / 50


class Time:
    """Goes on as it is told, and by waiting."""

    def __init__(self) -> None:
        self.now = 100.0

    def wait(self, seconds: float) -> None:
        assert seconds > 0
        self.now += seconds


def clocked(*intervals: float) -> tuple[list[bool], list[float]]:
    """Observations that come after so many periods each: which are late, and when they count."""
    time = Time()
    clock = Clock(50, lambda: time.now, time.wait)
    clock.begin()
    late, ticks = [], []
    for interval in intervals:
        time.now += interval * PERIOD
        late.append(clock.tick())
        ticks.append((time.now - 100) / PERIOD)
        assert clock.due == pytest.approx(time.now + PERIOD)
    return late, ticks


def test_a_device_that_keeps_its_own_time_is_never_waited_for() -> None:
    jitter = [1.1, 0.9, 1.4, 0.6, 1.0] * 40
    late, ticks = clocked(*jitter)
    assert not any(late) and ticks[-1] == pytest.approx(sum(jitter))


def test_an_observation_is_late_by_half_a_period_and_the_next_may_come_sooner() -> None:
    late, ticks = clocked(1, 1.49, 0.51, 1.6, 0.4, 1)
    assert late == [False, False, False, True, False, False]
    assert ticks[-1] == pytest.approx(6)


@pytest.mark.parametrize("busy", [0.0, 0.3])
def test_what_would_be_quicker_than_the_rate_is_made_to_wait(busy: float) -> None:
    late, ticks = clocked(*[busy] * 500)
    assert not any(late) and ticks[-1] == pytest.approx(499 / 1.01, rel=0.01)


def test_after_a_pause_no_more_than_one_period_is_caught_up() -> None:
    late, ticks = clocked(*[0.1] * 100, 30, *[0.1] * 100)
    assert sum(late) == 1 and ticks[-1] - ticks[100] == pytest.approx(99 / 1.01, rel=0.01)


def test_misses_are_counted_and_told_once_they_are_too_many() -> None:
    misses = Misses(("left", "right"))
    for step in range(20):
        misses.note((False, step % 2 == 0), late=False)
    assert misses.too_many is None  # ten of twenty
    misses.note((True, False), late=True)
    misses.note((False, False), late=True)
    assert misses.too_many == (
        "11 of 20 steps missed a deadline (answers too late: left 1, right 9; observations late: 2)"
    )
    assert misses.metrics == {"held": 11.0, "late": 2.0}
    assert str(misses) == "actions held: left 1, right 10; observations late: 2; of 22 steps"
    misses.begin()
    assert misses.too_many is None and misses.metrics["held"] == 11
