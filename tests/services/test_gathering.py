"""What a learner gathers is what the env host logged, also where that lost steps."""

import numpy as np
import pytest

from otc_dist.bus.messages import Moment, Observation, StepOutcome
from otc_dist.services.gathering import Gathering
from otc_dist.transitions import Transitions

COPIES = 2


def of_step(number: int, take: int) -> Transitions:
    """E transitions that tell their step, and which time it was taken."""
    value = np.full((COPIES, 1), 10.0 * take + number, np.float32)
    flags = np.zeros(COPIES, np.bool_)
    return Transitions(value, -value, value[:, 0] / 2, value + 1, flags, flags)


class Host:
    """Asks a learner step after step, and has the log that it may ask for."""

    def __init__(self, own: range) -> None:
        self.log: list[Transitions] = []
        self.fetched: list[tuple[int, int, int]] = []
        self._own = own
        self.restart()

    def restart(self) -> None:
        """The learner is another process from now on."""
        self.gathering = Gathering(COPIES, self._own, self._fetch)

    def _fetch(self, deployment: int, start: int, stop: int) -> Transitions:
        self.fetched.append((deployment, start, stop))
        return Transitions.concatenate(self.log[start:stop])

    def ask(self, step: int, take: int, epoch: int = 1) -> None:
        """Ask for that step's action, and log what comes of it; what was logged of it is lost."""
        del self.log[step:]
        moment, new = Moment("deployment", 1, epoch, step), of_step(step, take)
        self.gathering.take(Observation(moment, new.observations, self._outcome(step)))
        self.gathering.acted(moment, new.observations, new.actions)
        self.log.append(new)

    def _outcome(self, step: int) -> StepOutcome | None:
        if step == 0:
            return None
        before = self.log[step - 1]
        ends = before.terminated, before.truncated
        return StepOutcome(before.rewards, before.next_observations, *ends)

    def end(self, steps: int) -> None:
        """The question that carries the last outcome."""
        moment = Moment("deployment", 1, 1, steps)
        self.gathering.take(Observation(moment, None, self._outcome(steps)))

    def check(self) -> None:
        """D_k is what the log has of the learner's own steps, to the bit."""
        expected = Transitions.concatenate(self.log[self._own.start : self._own.stop])
        found = self.gathering.all(1)
        for name in vars(expected):
            assert getattr(found, name).tobytes() == getattr(expected, name).tobytes()


@pytest.mark.parametrize("own", [range(6), range(2, 4), range(4, 6)])
@pytest.mark.parametrize("again", range(1, 6))
def test_steps_that_the_log_lost_are_taken_again_and_no_longer_kept(own: range, again: int) -> None:
    """A power cut took the log's end from step `again` on; the learner has lived on."""
    host = Host(own)
    for step in range(6):
        host.ask(step, take=1)
    for step in range(again, 6):
        host.ask(step, take=2, epoch=2)
    host.end(6)
    host.check()


@pytest.mark.parametrize("at", range(1, 6))
def test_a_learner_that_was_restarted_asks_for_what_it_missed_and_for_no_more(at: int) -> None:
    host = Host(range(6))
    for step in range(6):
        if step == at:
            host.restart()
        host.ask(step, take=1)
    host.end(6)
    host.check()
    assert host.fetched == [(1, 0, at)]


def test_what_another_process_answered_in_its_name_is_fetched_and_nothing_else() -> None:
    host = Host(range(6))
    for step in range(6):
        if step in (2, 3):
            host.log.append(of_step(step, take=1))
        else:
            host.ask(step, take=1)
    host.end(6)
    host.check()
    assert host.fetched == [(1, 1, 4)]  # what step 1 brought came with the question of step 2


def test_an_answer_in_one_deployment_is_none_in_the_next() -> None:
    host = Host(range(6))
    host.ask(0, take=1)
    first = of_step(0, take=2)
    ends = first.terminated, first.truncated
    outcome = StepOutcome(first.rewards, first.next_observations, *ends)
    host.log = [first]
    host.gathering.take(Observation(Moment("deployment", 2, 1, 1), first.observations, outcome))
    assert host.fetched == [(2, 0, 1)]


def test_a_learner_that_was_there_all_the_time_asks_for_nothing() -> None:
    host = Host(range(6))
    for step in range(6):
        host.ask(step, take=1)
    host.end(6)
    host.check()
    assert host.fetched == []
