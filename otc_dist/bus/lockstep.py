"""Lock-step by stop-and-wait: nothing here needs a message to arrive.

The env host publishes a question to every agent and publishes it again until each has answered
this very moment (phase, deployment, epoch, step). A learner answers a question that it meets
again with the same bytes. So a lost message, a link that was cut, a slow or a restarted learner
costs time and nothing else.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence

from otc_dist.bus.codec import AgentCodec
from otc_dist.bus.keys import HOST, Keys
from otc_dist.bus.messages import Action, Moment, Observation
from otc_dist.bus.session import INBOX_SIZE, Session
from otc_dist.bus.status import StatusBoard
from otc_dist.bus.wire import RejectedError, Rejections
from otc_dist.envs.discrete_actions import refused
from otc_dist.spec import AgentSpec

_FIRST_REPEAT = 0.05  # seconds until a question is asked again; doubles
_SLOWEST_REPEAT = 1.0


class GaveUpError(Exception):
    """A deadline passed without a sign of life. The message is one line that names who and what."""


class HostLockstep:
    """The env host's side: ask all agents, wait for all answers.

    Args:
        copies: E, by phase.
        deadline: seconds without a sign of life from an agent that has not answered, after which
            `ask` gives up. A status that says the learner is busy is a sign of life; one that says
            it is ready is none.
        changed: agent -> when (time.monotonic) its process last came or went: one that has just
            ended is being started again.

    Attributes:
        answered: how many questions all agents have answered.
        resent: how many an agent was asked once more; both are read from any thread.
    """

    def __init__(
        self,
        session: Session,
        keys: Keys,
        agents: Sequence[AgentSpec],
        copies: Mapping[str, int],
        deadline: float,
        rejections: Rejections,
        changed: Callable[[str], float] = lambda _: -math.inf,
    ) -> None:
        self._changed = changed
        self._codecs = [AgentCodec(keys.run, agent, copies) for agent in agents]
        self._agents, self._names = agents, [agent.name for agent in agents]
        self._awaited: tuple[str, ...] = ()
        self.answered, self.resent = 0, 0
        self._rejections, self._deadline = rejections, deadline
        self._board = StatusBoard(session, keys, tuple(self._names), rejections)
        self._inboxes = [session.inbox(keys.action(agent)) for agent in self._names]
        self._puts = [session.publisher(keys.observation(agent)) for agent in self._names]

    @property
    def awaited(self) -> tuple[str, ...]:
        """Whose answers are overdue, from any thread: they have been asked again already."""
        return self._awaited

    def ask(self, questions: Sequence[Observation], *, acting: bool) -> list[Action]:
        """One question and one answer for each agent, in the agents' order.

        An answer that the task would not take is rejected like one that is no number.

        Args:
            questions: of one moment.
            acting: whether answers hold actions.

        Raises:
            GaveUpError: an agent showed no sign of life for `deadline` seconds.
        """
        answers = self._answers(questions, acting, math.inf)
        self.answered += 1
        return [answers[index] for index in range(len(questions))]

    def ask_until(self, questions: Sequence[Observation], until: float) -> list[Action | None]:
        """As `ask` for actions, but for no longer than `until` (time.monotonic).

        None for an agent whose answer is not there by then: one that comes later is rejected as
        stale, since the next question is another one.
        """
        answers = self._answers(questions, True, until)
        self.answered += len(answers) == len(questions)
        return [answers.get(index) for index in range(len(questions))]

    def _answers(
        self, questions: Sequence[Observation], acting: bool, until: float
    ) -> dict[int, Action]:
        """Place in the team -> answer; of all, or of those that have answered by `until`."""
        moment = questions[0].moment
        payloads: list[bytes] = []
        for codec, put, question in zip(self._codecs, self._puts, questions, strict=True):
            payload = codec.encode_observation(question)
            put(payload)
            payloads.append(payload)
        asked = time.monotonic()
        repeat, next_repeat = _FIRST_REPEAT, asked + _FIRST_REPEAT
        answers: dict[int, Action] = {}
        # One agent after the other, the one asked last first: meanwhile the others' answers
        # gather in their inboxes, and this process is not woken for each.
        for index in reversed(range(len(payloads))):
            while index not in answers:
                received = self._inboxes[index].get(min(next_repeat, until))
                answer = received and self._decode(index, received, questions[index], acting)
                if answer:
                    answers[index] = answer
                elif (now := time.monotonic()) >= until:
                    self._look(questions, acting, answers)
                    return answers
                elif now >= next_repeat:
                    missing = self._look(questions, acting, answers)
                    self._awaited = tuple(self._names[other] for other in missing)
                    for other in missing:
                        self._check_deadline(other, asked, moment)
                        self._puts[other](payloads[other])
                        self.resent += 1
                    repeat = min(2 * repeat, _SLOWEST_REPEAT)
                    next_repeat = now + repeat
        self._awaited = ()
        return answers

    def _look(
        self, questions: Sequence[Observation], acting: bool, answers: dict[int, Action]
    ) -> list[int]:
        """Take the answers that are there already; whose are missing."""
        for index, question in enumerate(questions):
            for _ in range(INBOX_SIZE):  # however fast more comes in
                if index in answers or (received := self._inboxes[index].look()) is None:
                    break
                if answer := self._decode(index, received, question, acting):
                    answers[index] = answer
        return [index for index in range(len(questions)) if index not in answers]

    def _decode(
        self, index: int, payload: bytes, question: Observation, acting: bool
    ) -> Action | None:
        agent, moment = self._agents[index], question.moment
        try:
            answer = self._codecs[index].decode_action(payload, moment, acting=acting)
            if answer.actions is None or question.observations is None:
                return answer
            copy = refused(agent, answer.actions, question.observations)
            if copy is None:
                return answer
            raise RejectedError(
                "unavailable",
                f"{agent.name} cannot take action {answer.actions[copy, 0]:g} in copy {copy}"
                f" ({_describe(moment)})",
            )
        except RejectedError as rejected:
            self._rejections.count(rejected)
            return None

    def _check_deadline(self, index: int, asked: float, moment: Moment) -> None:
        agent = self._names[index]
        newest = self._board.newest(agent)
        # Not by what it says now: its answer may still be on the way when it is ready.
        sign = max(asked, self._board.heard_busy(agent), self._changed(agent))
        if time.monotonic() - sign > self._deadline:
            state = f"it says {newest.phase!r}" if newest else "it was never heard from"
            raise GaveUpError(
                f"no answer from {agent} for {self._deadline:g} s ({state}) to {_describe(moment)}"
                f"{self._rejection_hint()}"
            )

    def _rejection_hint(self) -> str:
        counts = self._rejections.as_metrics()
        if not counts:
            return ""
        listed = ", ".join(f"{key.removeprefix('rejected/')} {n:.0f}" for key, n in counts.items())
        return f"; rejected messages: {listed}"


def _describe(moment: Moment) -> str:
    return f"{moment.phase} {moment.deployment}, step {moment.step}"


class LearnerLockstep:
    """A learner's side: the newest question, and the answer to it."""

    def __init__(
        self,
        session: Session,
        keys: Keys,
        agent: AgentSpec,
        copies: Mapping[str, int],
        rejections: Rejections,
    ) -> None:
        self._codec = AgentCodec(keys.run, agent, copies)
        self._rejections = rejections
        self._newest: Moment | None = None
        self._put = session.publisher(keys.action(agent.name))
        self._host = StatusBoard(session, keys, (HOST,), rejections)
        self._started = time.monotonic()
        self._inbox = session.inbox(keys.observation(agent.name))

    def question(self, timeout: float) -> Observation | None:
        """The newest question that waits; None if none comes within `timeout` seconds.

        Questions that the run has passed (an older epoch, an earlier moment) are rejected; the
        same moment is given again when it is asked again.
        """
        newest: Observation | None = None
        payload = self._inbox.get(time.monotonic() + timeout)
        while payload is not None:
            try:
                newest = self._in_order(self._codec.decode_observation(payload))
            except RejectedError as rejected:
                self._rejections.count(rejected)
            payload = self._inbox.look()
        return newest

    def _in_order(self, question: Observation) -> Observation:
        moment, newest = question.moment, self._newest
        if newest is not None:
            if moment.epoch < newest.epoch:
                raise RejectedError("epoch")
            if moment.epoch == newest.epoch and moment.position < newest.position:
                raise RejectedError("stale")
        self._newest = moment
        return question

    def answer(self, action: Action) -> None:
        self._put(self._codec.encode_action(action))

    def host_silence(self) -> float:
        """Seconds since the env host was last heard of, or since this side began."""
        return time.monotonic() - max(self._started, self._host.heard(HOST))

    @property
    def host_phase(self) -> str:
        """What the env host said last that it does; empty before that."""
        newest = self._host.newest(HOST)
        return newest.phase if newest else ""
