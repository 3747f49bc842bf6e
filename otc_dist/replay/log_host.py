"""Plays the env host's part on the bus, with a log in the place of an environment.

Learners and observers see what they saw then: the host's liveliness token and statuses, its
questions with observations and outcomes, and its answers to queries for the spec and for history.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Self

from otc_dist.bus.agreement import copies_by_phase, longest_message, run_spec
from otc_dist.bus.codec import POLICY_DIGEST_LENGTH, AgentCodec
from otc_dist.bus.handshake import offer
from otc_dist.bus.history import Read, history_reply
from otc_dist.bus.keys import HOST, Keys
from otc_dist.bus.lockstep import HostLockstep
from otc_dist.bus.messages import Action, Moment, Observation, Phase, Status, StepOutcome
from otc_dist.bus.presence import Presence
from otc_dist.bus.session import Session
from otc_dist.bus.status import Heartbeat, StatusBoard
from otc_dist.bus.wire import Rejections
from otc_dist.deployment_log.header import LogHeader
from otc_dist.description import Description
from otc_dist.transitions import JointStep

UNKNOWN_POLICY = "0" * POLICY_DIGEST_LENGTH  # of an unfinished log, which names none


_FAREWELL = 5.0  # seconds that learners may take to leave once all is done


class OtherActionError(Exception):
    """A learner answers differently from the log. The message is one line."""


class LogHost:
    """The env host of logs of one run. Use it as a context manager.

    Args:
        session: the centre of the bus.
        header: of any of the logs.
        indices: places in the team of the agents to publish for.
        read: agent -> what reads its transitions for a learner that asks for its past.
        epoch: later than those of any host that these learners have heard: what is earlier, they
            reject.
    """

    def __init__(
        self,
        session: Session,
        header: LogHeader,
        description: Description,
        indices: Sequence[int],
        read: Callable[[str], Read],
        epoch: int,
    ) -> None:
        self.session, self.indices = session, indices
        self.agents = [header.team.agents[index] for index in indices]
        self.names = [agent.name for agent in self.agents]
        self.deadline = description.bus.answer_deadline
        self.keys = Keys(header.run, description.shared_digest())
        self.copies = copies_by_phase(description)
        self.rejections = Rejections()
        self._epoch = epoch
        self._status = Status(HOST)
        self._heartbeat = Heartbeat(session, self.keys, HOST, self.rejections, lambda: self._status)
        longest = longest_message(description, header.team)
        for agent in self.agents:
            pages = read(agent.name)
            reply = history_reply(self.keys, agent, description, longest, pages, self.rejections)
            session.answer(self.keys.history(agent.name), reply)
        offer(session, self.keys, run_spec(description, header.team))
        session.declare_alive(self.keys.alive(HOST))

    def __enter__(self) -> Self:
        self._heartbeat.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._heartbeat.__exit__()

    def enter(self, phase: Phase, deployment: int, total: int) -> None:
        """Say what comes now."""
        self._status = Status(HOST, phase, deployment, 0, total)
        self._heartbeat.publish()

    def moment(self, phase: Phase, deployment: int, step: int) -> Moment:
        """Of a question now; the status reports it."""
        self._status = replace(self._status, update=step)
        return Moment(phase, deployment, self._epoch, step)


class LogPublisher:
    """Publishes what was asked and what was answered, and waits for nobody."""

    def __init__(self, host: LogHost) -> None:
        self._host = host
        session, keys, run = host.session, host.keys, host.keys.run
        self._codecs = [AgentCodec(run, agent, host.copies) for agent in host.agents]
        self._ask = [session.publisher(keys.observation(name)) for name in host.names]
        self._act = [session.publisher(keys.action(name)) for name in host.names]

    def publish(
        self, deployment: int, total: int, steps: Iterable[JointStep], policies: Mapping[str, str]
    ) -> None:
        """Publish each step's questions and answers, of all agents."""
        host = self._host
        host.enter("deployment", deployment, total)
        before: JointStep | None = None
        for step in steps:
            moment = host.moment("deployment", deployment, step.step)
            # A question carries the outcome of the step before it; after a gap there is none.
            known = step.step == 0 or (before is not None and before.step == step.step - 1)
            for place, index in enumerate(host.indices):
                codec = self._codecs[place]
                if known:
                    question = _question(moment, index, step, before)
                    self._ask[place](codec.encode_observation(question))
                policy = policies.get(host.names[place], UNKNOWN_POLICY)
                action = Action(moment, step.actions[index], policy)
                self._act[place](codec.encode_action(action))
            before = step


class AnswerChecker:
    """Asks the agents' learners what the log was asked, and holds them to its answers.

    Args:
        heard: called on Zenoh's thread with each status of a learner; it must be quick.
    """

    def __init__(self, host: LogHost, heard: Callable[[Status], None]) -> None:
        self._host = host
        StatusBoard(host.session, host.keys, tuple(host.names), host.rejections, heard)
        self._lockstep = HostLockstep(
            host.session, host.keys, host.agents, host.copies, host.deadline, host.rejections
        )
        self._presence = Presence(host.session, host.keys, host.names)

    def wait_for_learners(self, waited: Callable[[float], None]) -> None:
        """Return when all have come; see `Presence.wait_for_all`. Raises GaveUpError."""
        self._presence.wait_for_all(self._host.deadline, waited)

    def ask(
        self, deployment: int, total: int, steps: Iterable[JointStep], policies: Mapping[str, str]
    ) -> None:
        """Ask each step, and go on when all have answered; `steps` are all of the deployment.

        Raises:
            OtherActionError: a learner answers differently from the log.
            GaveUpError: one shows no sign of life for as long as the run's description allows.
        """
        host = self._host
        host.enter("deployment", deployment, total)
        last: JointStep | None = None
        for step in steps:
            moment = host.moment("deployment", deployment, step.step)
            questions = [_question(moment, index, step, last) for index in host.indices]
            answers = self._lockstep.ask(questions, acting=True)
            for name, index, answer in zip(host.names, host.indices, answers, strict=True):
                _check(name, answer, step, index, policies[name])
            last = step
        if last is not None:
            moment = host.moment("deployment", deployment, last.step + 1)
            questions = [
                # What it would see next does not matter: nobody acts on it.
                Observation(moment, last.next_observations[index], StepOutcome.of(last, index))
                for index in host.indices
            ]
            self._lockstep.ask(questions, acting=False)

    def end(self, deployment: int) -> None:
        """Wait until the learners hold pi_k, and let them go. Raises GaveUpError."""
        moment = self._host.moment("done", deployment, 0)
        nothing = [Observation(moment, None, None)] * len(self._host.agents)
        self._lockstep.ask(nothing, acting=False)
        self._host.enter("done", deployment, 0)
        self._presence.wait_for_none(_FAREWELL)


def _question(moment: Moment, index: int, step: JointStep, before: JointStep | None) -> Observation:
    outcome = None if before is None or step.step == 0 else StepOutcome.of(before, index)
    return Observation(moment, step.observations[index], outcome)


def _check(name: str, answer: Action, step: JointStep, index: int, policy: str) -> None:
    if answer.policy != policy:
        raise OtherActionError(
            f"{name} acts by policy {answer.policy} in step {step.step}, but {policy} acted in the"
            " log: this learner is not the one that was there"
        )
    if step.held and step.held[index]:
        return  # its answer came too late there, and nobody knows what it was
    if answer.actions is None or answer.actions.tobytes() != step.actions[index].tobytes():
        raise OtherActionError(
            f"{name} acts differently in step {step.step} from the log, although by the same"
            " policy: this machine computes different bits"
        )
