"""Plays the env host's part on the bus, with a log in the place of an environment.

Learners and observers see what they saw then: the host's liveliness token and statuses, its
questions with observations and outcomes, and its answers to queries for the spec and for history.
"""

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import TracebackType
from typing import Self

from otc_dist.bus.agreement import copies_by_phase, longest_message, run_spec
from otc_dist.bus.codec import POLICY_DIGEST_LENGTH, AgentCodec
from otc_dist.bus.handshake import offer
from otc_dist.bus.history import Read, history_reply
from otc_dist.bus.keys import HOST, Keys
from otc_dist.bus.lockstep import HostLockstep
from otc_dist.bus.messages import Action, Moment, Observation, Status, StepOutcome
from otc_dist.bus.session import Session
from otc_dist.bus.status import Heartbeat
from otc_dist.bus.wire import Rejections
from otc_dist.deployment_log.header import LogHeader
from otc_dist.description import Description
from otc_dist.transitions import JointStep

UNKNOWN_POLICY = "0" * POLICY_DIGEST_LENGTH  # of an unfinished log, which names none


_FAREWELL = 5.0  # seconds that learners may take to leave once all is done


class OtherActionError(Exception):
    """A learner answers otherwise than the log. The message is one line."""


class LogHost:
    """The env host of logs of one run. Use it as a context manager.

    Args:
        session: the centre of the bus.
        header: of any of the logs.
        agents: places in the team of those to publish for.
        read: agent -> what reads its transitions for a learner that asks for its past.
    """

    def __init__(
        self,
        session: Session,
        header: LogHeader,
        description: Description,
        agents: Sequence[int],
        read: Callable[[str], Read],
    ) -> None:
        self._session, self._indices = session, agents
        self._agents = [header.team.agents[index] for index in agents]
        self._names = [agent.name for agent in self._agents]
        self._deadline = description.bus.answer_deadline
        self._keys, self._copies = Keys(header.run), copies_by_phase(description)
        # Later than those of any host of this run before: learners reject what is earlier.
        self._epoch = int(time.time())
        self._rejections = Rejections()
        self._status = Status(HOST)
        self._heartbeat = Heartbeat(
            session, self._keys, HOST, self._rejections, lambda: self._status
        )
        longest = longest_message(description, header.team)
        for agent in self._agents:
            reply = history_reply(
                self._keys, agent, description, longest, read(agent.name), self._rejections
            )
            session.answer(self._keys.history(agent.name), reply)
        offer(session, self._keys, run_spec(description, header.team))
        session.declare_alive(self._keys.alive(HOST))

    def __enter__(self) -> Self:
        self._heartbeat.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._heartbeat.__exit__()

    def _enter(self, phase: str, deployment: int, total: int) -> None:
        self._status = Status(HOST, phase, deployment, 0, total)
        self._heartbeat.publish()

    def _moment(self, deployment: int, step: int) -> Moment:
        """Of a question now; the status tells of it."""
        self._status = replace(self._status, update=step)
        return Moment("deployment", deployment, self._epoch, step)


class Teller(LogHost):
    """Publishes what was asked and what was answered, and waits for nobody."""

    def __init__(
        self,
        session: Session,
        header: LogHeader,
        description: Description,
        agents: Sequence[int],
        read: Callable[[str], Read],
    ) -> None:
        super().__init__(session, header, description, agents, read)
        self._codecs = [AgentCodec(header.run, agent, self._copies) for agent in self._agents]
        self._ask = [session.publisher(self._keys.observation(name)) for name in self._names]
        self._act = [session.publisher(self._keys.action(name)) for name in self._names]

    def tell(
        self, deployment: int, total: int, steps: Iterable[JointStep], policies: Mapping[str, str]
    ) -> None:
        """Publish each step's questions and answers, of all agents."""
        self._enter("deployment", deployment, total)
        before: JointStep | None = None
        for step in steps:
            moment = self._moment(deployment, step.step)
            # A question tells the outcome of the step before it; behind a gap there is none.
            known = step.step == 0 or (before is not None and before.step == step.step - 1)
            for place, index in enumerate(self._indices):
                codec = self._codecs[place]
                if known:
                    question = _question(moment, index, step, before)
                    self._ask[place](codec.encode_observation(question))
                policy = policies.get(self._names[place], UNKNOWN_POLICY)
                action = Action(moment, step.actions[index], policy)
                self._act[place](codec.encode_action(action))
            before = step


class Asker(LogHost):
    """Asks the agents' learners what the log was asked, and holds them to its answers."""

    def __init__(
        self,
        session: Session,
        header: LogHeader,
        description: Description,
        agents: Sequence[int],
        read: Callable[[str], Read],
    ) -> None:
        super().__init__(session, header, description, agents, read)
        self._lockstep = HostLockstep(
            session, self._keys, self._agents, self._copies, self._deadline, self._rejections
        )
        self._present: set[str] = set()
        self._changed = threading.Condition()
        for name in self._names:
            session.watch_alive(self._keys.alive(name), partial(self._note, name))

    def _note(self, name: str, alive: bool) -> None:
        with self._changed:
            (self._present.add if alive else self._present.discard)(name)
            self._changed.notify_all()

    def ask(
        self, deployment: int, total: int, steps: Iterable[JointStep], policies: Mapping[str, str]
    ) -> None:
        """Ask each step, and go on when all have answered; `steps` are all of the deployment.

        Raises:
            OtherActionError: a learner answers otherwise than the log.
            GaveUpError: one shows no sign of life for as long as the run's description allows.
        """
        self._enter("deployment", deployment, total)
        last: JointStep | None = None
        for step in steps:
            moment = self._moment(deployment, step.step)
            questions = [_question(moment, index, step, last) for index in self._indices]
            answers = self._lockstep.ask(questions, acting=True)
            for name, index, answer in zip(self._names, self._indices, answers, strict=True):
                _check(name, answer, step, index, policies[name])
            last = step
        if last is not None:
            moment = self._moment(deployment, last.step + 1)
            questions = [
                # What it would see next does not matter: nobody acts on it.
                Observation(moment, last.next_observations[index], _outcome(last, index))
                for index in self._indices
            ]
            self._lockstep.ask(questions, acting=False)

    def end(self, deployment: int) -> None:
        """Wait until the learners hold pi_k, and let them go. Raises GaveUpError."""
        moment = Moment("done", deployment, self._epoch, 0)
        self._lockstep.ask([Observation(moment, None, None)] * len(self._agents), acting=False)
        self._enter("done", deployment, 0)
        with self._changed:
            self._changed.wait_for(lambda: not self._present, timeout=_FAREWELL)


def _question(moment: Moment, index: int, step: JointStep, before: JointStep | None) -> Observation:
    outcome = None if before is None or step.step == 0 else _outcome(before, index)
    return Observation(moment, step.observations[index], outcome)


def _outcome(step: JointStep, index: int) -> StepOutcome:
    return StepOutcome(
        step.rewards[index], step.next_observations[index], step.terminated, step.truncated
    )


def _check(name: str, answer: Action, step: JointStep, index: int, policy: str) -> None:
    if answer.policy != policy:
        raise OtherActionError(
            f"{name} acts by policy {answer.policy} in step {step.step}, but {policy} acted in the"
            " log: this learner is not the one that was there"
        )
    if answer.actions is None or answer.actions.tobytes() != step.actions[index].tobytes():
        raise OtherActionError(
            f"{name} acts otherwise in step {step.step} than in the log, though by the same policy:"
            " this machine computes other bits"
        )
