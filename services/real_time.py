"""A deployment of devices that do not wait: by a clock, with the answers that are there in time.

An agent whose answer is not there when it is due acts as it did before: its action is held, and
logged as what was executed, with a flag. In an episode's first step there is nothing to hold;
nothing moves yet either, and so all answers are waited for. When an episode is over, the
environment is closed at once: devices rest whenever none is under way.

An episode that cannot go on, since a person stops it, the process died in it, or too many deadlines
are missed, is broken off: one step more, which did not happen, is logged as terminated *and*
truncated, as if a simulator had broken off. Such an episode measures nothing, nobody learns from
that step, and what happened before it counts like everything else.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from otc_dist.bus.messages import Action
from otc_dist.envs.base import BatchedEnv
from otc_dist.envs.discrete_actions import refused
from otc_dist.envs.rollout import Rollout
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32, JointStep

from . import person
from .clock import Clock, Misses
from .host_report import HostReport
from .process import Run, orderly

log = logging.getLogger(__name__)

_TRIES = 3  # episodes in a row that may be broken off soon
_SOON = 100  # steps

Ask = Callable[[JointStep | None, float | None], Sequence[Action | None]]


class RealTime:
    """Plays deployment `k` by the clock of this process.

    Args:
        rollout: at the end of what is logged; its next episode has not begun.
        ask: the agents, given the last step, by when answers are due, or None: as long as it takes.
        write: logs a step.
        rest: closes the environment, which can be reset again.
    """

    def __init__(
        self,
        run: Run,
        k: int,
        rollout: Rollout,
        ask: Ask,
        write: Callable[[JointStep], None],
        rest: Callable[[], None],
        report: HostReport,
    ) -> None:
        self._folder, self._settings = run.folder, run.description.deployment
        self._agents, self._schedule, self._k = run.team.agents, run.schedule, k
        self._rollout, self._report = rollout, report
        self._ask, self._write, self._rest = ask, write, rest
        assert self._settings.rate_hz is not None
        self._rate = self._settings.rate_hz
        self._clock, self._misses = Clock(self._rate), Misses(run.team.names)
        self._broken_off, self._in_a_row = 0, 0

    def play(self, last: JointStep | None) -> JointStep | None:
        """Go on behind `last`, the last logged step; returns the deployment's last.

        Raises:
            StoppedByFileError: a person stops it.
            UserError: the rate cannot be held.
        """
        if last is not None and not (self._complete or self._rollout.over):
            log.warning("deployment %d: its last episode was left: it is broken off", self._k)
            last = self._break_off(last)
        while not self._complete:
            person.obey(self._folder)
            self._reset()
            last = self._play_episode(last)
        log.info("deployment %d, %g Hz: %s", self._k, self._rate, self._misses)
        return last

    @property
    def _complete(self) -> bool:
        return self._rollout.step == self._schedule.steps

    def _reset(self) -> None:
        """Begin an episode, once a person has reset the devices if that is asked for."""
        self._report.within("reset")
        if self._settings.reset_by_hand:
            approval, k, step = self._folder.reset_approval, self._k, self._rollout.step
            approval.unlink(missing_ok=True)  # of an earlier reset
            content = {
                "waits_for": f"a person to reset the devices, in deployment {k}, step {step}",
                "deployment": k,
                "policy": k - 1,
                "step": step,
            }
            person.wait_for(self._folder, approval, content)
            approval.unlink(missing_ok=True)
        self._rollout.renew()
        self._report.within("deployment")

    def _play_episode(self, last: JointStep | None) -> JointStep:
        begun, answers = self._rollout.step, self._ask(last, None)
        with orderly() as signalled:
            last, missed = self._play_steps(answers, signalled)
            self._rest()
            if not (self._rollout.over or self._complete):
                last = self._break_off(last)
            if missed is None:
                self._in_a_row = 0
            else:
                self._judge(missed, last.step - begun)
        return last

    def _play_steps(
        self, answers: Sequence[Action | None], signalled: Callable[[], bool]
    ) -> tuple[JointStep, str | None]:
        """The episode from its first `answers` on, as far as it goes: its last step, and which
        deadlines were missed if these were too many.
        """
        rollout, acting = self._rollout, _executed(answers, ())
        self._misses.begin()
        self._clock.begin()
        while True:
            step = rollout.play(acting, self._schedule.exploring(rollout.step))
            held = tuple(answer is None for answer in answers)
            step = replace(step, held=held, late=self._clock.tick())
            self._write(step)
            self._misses.note(step.held, step.late)
            self._tell()
            over = rollout.over or self._complete
            if over or signalled() or person.stops(self._folder):
                return step, None
            if missed := self._misses.too_many:
                return step, missed
            answers = self._ask(step, self._clock.due)
            acting = _executed(answers, acting)
            if agent := self._stuck(acting):
                log.warning("%s cannot do what it did before: its episode is broken off", agent)
                return step, None

    def _break_off(self, last: JointStep) -> JointStep:
        """Log that the episode under way ends with `last`."""
        over = np.ones_like(last.terminated)
        closing = replace(
            last,
            step=self._rollout.step,
            observations=last.next_observations,
            rewards=tuple(np.zeros_like(rewards) for rewards in last.rewards),
            terminated=over,
            truncated=over,
            exploring=self._schedule.exploring(self._rollout.step),
            held=(True,) * len(last.held),
            late=False,
        )
        self._rollout.take(closing)
        self._write(closing)
        self._broken_off += 1
        self._tell()
        return closing

    def _stuck(self, acting: Sequence[Float32]) -> str | None:
        """Whose discrete action, held, is not available any more; None: nobody's."""
        seen = self._rollout.observations
        for agent, actions, observations in zip(self._agents, acting, seen, strict=True):
            if refused(agent, actions, observations) is not None:
                return agent.name
        return None

    def _judge(self, missed: str, steps: int) -> None:
        """Go on with another episode, unless those before have not lasted either."""
        self._in_a_row = self._in_a_row + 1 if steps <= _SOON else 1
        if self._in_a_row == _TRIES:
            raise UserError(
                f"deployment.rate_hz = {self._rate:g} cannot be held: {missed}, and so in each of"
                f" {_TRIES} episodes; what was logged stays"
            )
        log.warning(
            "deployment %d, step %d: the episode is broken off, since %s",
            *(self._k, self._rollout.step, missed),
        )

    def _tell(self) -> None:
        self._report.metrics = {**self._misses.metrics, "broken_off": float(self._broken_off)}


@contextmanager
def at_rest(env: BatchedEnv) -> Iterator[None]:
    """At the end, whatever ends it, close `env`; of two errors the first is told, the other noted.

    Raises:
        UserError: the user's code cannot be closed.
    """
    try:
        yield
    except BaseException:
        try:
            env.close()
        except UserError as error:
            log.warning("%s", error)
        raise
    env.close()


def _executed(answers: Sequence[Action | None], acting: Sequence[Float32]) -> list[Float32]:
    """What each agent does: its answer or, where there is none in time, what it did before."""
    found = []
    for index, answer in enumerate(answers):
        given = acting[index] if answer is None else answer.actions
        assert given is not None  # it was asked to act
        found.append(given)
    return found
