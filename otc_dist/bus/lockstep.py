"""Lock-step by stop-and-wait: nothing here needs a message to arrive.

The env host publishes a question to every agent and publishes it again until each has answered
this very moment (phase, deployment, epoch, step). A learner answers a question that it meets
again with the same bytes. So a lost message, a link that was cut, a slow or a restarted learner
costs time and nothing else.
"""

import time
from collections.abc import Mapping, Sequence

from otc_dist.bus.codec import AgentCodec
from otc_dist.bus.keys import HOST, Keys
from otc_dist.bus.messages import Action, Moment, Observation
from otc_dist.bus.session import Session
from otc_dist.bus.status import BUSY, StatusBoard
from otc_dist.bus.wire import RejectedError, Rejections
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
            `ask` gives up. An answer or a status that says the learner is busy is a sign of life;
            a status that says it is ready is none.
    """

    def __init__(
        self,
        session: Session,
        keys: Keys,
        agents: Sequence[AgentSpec],
        copies: Mapping[str, int],
        deadline: float,
        rejections: Rejections,
    ) -> None:
        self._codecs = [AgentCodec(keys.run, agent, copies) for agent in agents]
        self._names = [agent.name for agent in agents]
        self._rejections, self._deadline = rejections, deadline
        self._board = StatusBoard(session, keys, tuple(self._names), rejections)
        self._inboxes = [session.inbox(keys.action(agent)) for agent in self._names]
        self._puts = [session.publisher(keys.observation(agent)) for agent in self._names]

    def ask(self, questions: Sequence[Observation], *, acting: bool) -> list[Action]:
        """One question and one answer for each agent, in the agents' order.

        Args:
            questions: of one moment.
            acting: whether answers hold actions.

        Raises:
            GaveUpError: an agent showed no sign of life for `deadline` seconds.
        """
        moment = questions[0].moment
        payloads: list[bytes] = []
        for codec, put, question in zip(self._codecs, self._puts, questions, strict=True):
            payload = codec.encode_observation(question)
            put(payload)
            payloads.append(payload)
        asked = time.monotonic()
        repeat, next_repeat = _FIRST_REPEAT, asked + _FIRST_REPEAT
        answers: list[Action] = []
        # One agent after the other, who was asked last first: meanwhile the others' answers
        # gather in their inboxes, and this process is not woken for each.
        missing = len(payloads)
        while missing:
            received = self._inboxes[missing - 1].get(next_repeat)
            answer = received and self._decode(missing - 1, received, moment, acting)
            if answer:
                answers.append(answer)
                missing -= 1
            elif (now := time.monotonic()) >= next_repeat:
                self._check_deadline(missing - 1, asked, moment)
                for put, payload in zip(self._puts[:missing], payloads[:missing], strict=True):
                    put(payload)
                repeat = min(2 * repeat, _SLOWEST_REPEAT)
                next_repeat = now + repeat
        answers.reverse()
        return answers

    def _decode(self, index: int, payload: bytes, moment: Moment, acting: bool) -> Action | None:
        try:
            return self._codecs[index].decode_action(payload, moment, acting=acting)
        except RejectedError as rejected:
            self._rejections.count(rejected)
            return None

    def _check_deadline(self, index: int, asked: float, moment: Moment) -> None:
        agent = self._names[index]
        newest = self._board.newest(agent)
        busy = newest is not None and newest.phase in BUSY
        sign = max(asked, self._board.heard(agent)) if busy else asked
        if time.monotonic() - sign > self._deadline:
            what = f"{moment.phase} {moment.deployment}, step {moment.step}"
            state = f"it says {newest.phase!r}" if newest else "it was never heard of"
            raise GaveUpError(
                f"no answer from {agent} for {self._deadline:g} s ({state}) to {what}"
                f"{self._rejection_hint()}"
            )

    def _rejection_hint(self) -> str:
        counts = self._rejections.as_metrics()
        if not counts:
            return ""
        listed = ", ".join(f"{key.removeprefix('rejected/')} {n:.0f}" for key, n in counts.items())
        return f"; rejected messages: {listed}"


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

        Questions that the run has left behind (an older epoch, an earlier moment) are rejected; the
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
