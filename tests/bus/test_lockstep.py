"""Stop-and-wait over real sessions: whatever is lost, repeated or wrong only costs time."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from otc_dist.bus.codec import AgentCodec
from otc_dist.bus.endpoints import Endpoint
from otc_dist.bus.keys import Keys
from otc_dist.bus.lockstep import GaveUpError, HostLockstep, LearnerLockstep
from otc_dist.bus.messages import Action, Moment, Observation, Status
from otc_dist.bus.session import Session
from otc_dist.bus.status import Heartbeat, StatusBoard
from otc_dist.bus.wire import Rejections
from otc_dist.spec import AgentSpec

PATIENCE = 60.0  # seconds; only a test that fails waits as long
DIGEST = "0" * 16
KEYS = Keys("run", "digest")
AGENTS = tuple(AgentSpec(f"agent_{i}", 2, (-1.0,), (1.0,)) for i in range(2))
COPIES = {"deployment": 1, "evaluation": 1, "done": 0}


def _questions(step: int, epoch: int = 1) -> list[Observation]:
    moment = Moment("evaluation", 0, epoch, step)
    return [Observation(moment, np.full((1, 2), i + step, np.float32), None) for i in range(2)]


def _act(question: Observation) -> Action:
    assert question.observations is not None
    return Action(question.moment, 2 * question.observations[:, :1], DIGEST)


class Learners:
    """Threads that answer; `log` is every question each was given."""

    def __init__(
        self, endpoint: str, answer: Callable[[LearnerLockstep, Observation], None]
    ) -> None:
        self.log: list[list[Moment]] = [[] for _ in AGENTS]
        self.rejections = [Rejections() for _ in AGENTS]
        self._over = threading.Event()
        self._sessions = [Session.connect(Endpoint(endpoint), 4096, PATIENCE) for _ in AGENTS]
        self._threads = []
        for index, (session, agent) in enumerate(zip(self._sessions, AGENTS, strict=True)):
            side = LearnerLockstep(session, KEYS, agent, COPIES, self.rejections[index])
            self._threads.append(threading.Thread(target=self._work, args=(index, side, answer)))
        for thread in self._threads:
            thread.start()

    def _work(
        self,
        index: int,
        side: LearnerLockstep,
        answer: Callable[[LearnerLockstep, Observation], None],
    ) -> None:
        while not self._over.is_set():
            question = side.question(0.1)
            if question is not None:
                self.log[index].append(question.moment)
                answer(side, question)

    def close(self) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()
        for session in self._sessions:
            session.close()


@contextmanager
def _bus(
    endpoint: str,
    answer: Callable[[LearnerLockstep, Observation], None],
    deadline: float = PATIENCE,
) -> Iterator[tuple[HostLockstep, Learners, Session, Rejections]]:
    rejections = Rejections()
    with Session.listen([Endpoint(endpoint)], 4096) as session:
        host = HostLockstep(session, KEYS, AGENTS, COPIES, deadline, rejections)
        learners = Learners(endpoint, answer)
        try:
            yield host, learners, session, rejections
        finally:
            learners.close()


def test_every_agent_answers_its_own_question(endpoint: str) -> None:
    with _bus(endpoint, lambda side, question: side.answer(_act(question))) as (host, *_):
        for step in range(50):
            answers = host.ask(_questions(step), acting=True)
            assert [a.actions.tolist() for a in answers if a.actions is not None] == [
                [[2.0 * step]],
                [[2.0 * (step + 1)]],
            ]


def test_lost_answers_are_asked_for_again(endpoint: str) -> None:
    lost: set[Moment] = set()

    def answer(side: LearnerLockstep, question: Observation) -> None:
        if question.moment in lost:
            side.answer(_act(question))
        lost.add(question.moment)  # the first answer to each question is lost

    with _bus(endpoint, answer) as (host, *_):
        for step in range(3):
            assert len(host.ask(_questions(step), acting=True)) == 2
        assert host.answered == 3 and host.resent >= 3


def test_answers_given_twice_are_counted_and_ignored(endpoint: str) -> None:
    def answer(side: LearnerLockstep, question: Observation) -> None:
        side.answer(_act(question))
        side.answer(_act(question))

    with _bus(endpoint, answer) as (host, _, _, rejections):
        for step in range(20):
            host.ask(_questions(step), acting=True)
        assert rejections["stale"] > 0


def test_bad_answers_are_counted_and_the_good_one_still_counts(endpoint: str) -> None:
    def answer(side: LearnerLockstep, question: Observation) -> None:
        good = _act(question)
        side.answer(Action(good.moment._replace(epoch=9), good.actions, DIGEST))
        side.answer(Action(good.moment, np.zeros((3, 1), np.float32), DIGEST))
        side.answer(Action(good.moment, np.full((1, 1), np.nan, np.float32), DIGEST))
        side._put(b"garbage")
        side._put(b"")  # no message at all: it only wakes
        side.answer(good)

    with _bus(endpoint, answer) as (host, _, _, rejections):
        answers = host.ask(_questions(1), acting=True)
        assert [a.actions is not None and a.actions.item() for a in answers] == [2.0, 4.0]
        assert all(rejections[r] == 2 for r in ("epoch", "shape", "not-finite", "malformed"))


def _masked(step: int) -> list[Observation]:
    """Of two actions, agent_0 has the first only, and agent_1 the second."""
    moment = Moment("evaluation", 0, 1, step)
    return [Observation(moment, np.eye(2, dtype=np.float32)[[i]], None) for i in range(2)]


def test_an_action_that_the_task_would_not_take_is_rejected_like_one_that_is_no_number(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    discrete = tuple(AgentSpec(f"agent_{i}", 2, (0.0,), (1.0,), choices=2) for i in range(2))
    monkeypatch.setitem(globals(), "AGENTS", discrete)
    wrong = (0.0, 0.5, -1.0, 2.0, 1e9)

    def answer(side: LearnerLockstep, question: Observation) -> None:
        assert question.observations is not None
        own = question.observations.argmax()
        for action in (*wrong, 1.0) if own else (0.0,):
            side.answer(Action(question.moment, np.full((1, 1), action, np.float32), DIGEST))

    with _bus(endpoint, answer) as (host, _, _, rejections):
        answers = host.ask(_masked(3), acting=True)
    assert [a.actions is not None and a.actions.item() for a in answers] == [0.0, 1.0]
    assert rejections["unavailable"] >= len(wrong)
    assert "agent_1 cannot take action 0 in copy 0 (evaluation 0, step 3)" in caplog.text


def test_whose_answer_is_missing_is_known_while_it_is(endpoint: str) -> None:
    """Not of those that have answered, wherever they stand in the team."""
    waits = threading.Event()

    def answer(side: LearnerLockstep, question: Observation) -> None:
        if question.observations is not None and question.observations[0, 0] % 2 == 1:
            assert waits.wait(PATIENCE)  # agent_1 only
        side.answer(_act(question))

    with _bus(endpoint, answer) as (host, *_):
        asking = threading.Thread(target=host.ask, args=(_questions(0),), kwargs={"acting": True})
        asking.start()
        end = time.monotonic() + PATIENCE
        while host.awaited != ("agent_1",):
            assert time.monotonic() < end
        waits.set()
        asking.join()
        assert host.awaited == ()


def test_a_learner_whose_process_has_just_gone_is_given_the_time_to_come_again(
    endpoint: str,
) -> None:
    """Its launcher has ended it a moment before the env host would have given up."""
    gone, deadline = [-math.inf], 0.5
    with Session.listen([Endpoint(endpoint)], 4096) as session:
        lockstep = HostLockstep(
            session, KEYS, AGENTS, COPIES, deadline, Rejections(), lambda _: gone[0]
        )
        begun = time.monotonic()
        gone[0] = begun + 2 * deadline
        with pytest.raises(GaveUpError):
            lockstep.ask(_questions(0), acting=True)
        assert time.monotonic() - begun > 3 * deadline


def test_a_restarted_process_is_heard_whatever_its_clock_says(endpoint: str) -> None:
    """And what it or its predecessor said before is no sign of life when it is sent again."""
    board: list[StatusBoard] = []
    said: list[bytes] = []
    rejections, phase = Rejections(), ["offline"]
    with (
        Session.listen([Endpoint(endpoint)], 4096) as session,
        Session.connect(Endpoint(endpoint), 4096, PATIENCE) as learner,
    ):
        session.subscribe(KEYS.status("agent_0"), said.append)
        board.append(StatusBoard(session, KEYS, ("agent_0",), rejections))

        def until(condition: Callable[[], bool]) -> None:
            end = time.monotonic() + PATIENCE
            while not condition():
                assert time.monotonic() < end

        def newest() -> str:
            status = board[0].newest("agent_0")
            return status.phase if status else ""

        for phase[0] in ("offline", "tuning"):  # another process each time
            with Heartbeat(
                learner, KEYS, "agent_0", Rejections(), lambda: Status("agent_0", phase[0])
            ) as heart:
                until(lambda: heart.publish() or newest() == phase[0])
        put = learner.publisher(KEYS.status("agent_0"))
        recorded = list(said)
        for payload in recorded:
            put(payload)
        until(lambda: rejections["stale"] == len(recorded))
        assert newest() == "tuning"


def test_a_learner_rejects_what_the_run_has_left_behind(endpoint: str) -> None:
    with _bus(endpoint, lambda side, question: side.answer(_act(question))) as bus:
        host, learners, session, _ = bus
        host.ask(_questions(5, epoch=2), acting=True)
        codec = AgentCodec("run", AGENTS[0], COPIES)
        put = session.publisher(KEYS.observation("agent_0"))
        for old in (_questions(4, epoch=2)[0], _questions(6, epoch=1)[0]):
            put(codec.encode_observation(old))
        put(b"garbage")
        host.ask(_questions(6, epoch=2), acting=True)
        counted = learners.rejections[0]
        assert (counted["stale"], counted["epoch"], counted["malformed"]) == (1, 1, 1)
        assert {moment.step for moment in learners.log[0]} == {5, 6}


def test_a_learner_that_never_answers_is_named_in_one_line(endpoint: str) -> None:
    def answer(side: LearnerLockstep, question: Observation) -> None:
        if question.observations is not None and question.observations[0, 0] % 2 == 0:
            side.answer(_act(question))  # agent_0 only

    with (
        _bus(endpoint, answer, deadline=0.3) as (host, *_),
        pytest.raises(GaveUpError, match=r"agent_1 for 0.3 s .* evaluation 0, step 2") as error,
    ):
        host.ask(_questions(2), acting=True)
    assert "\n" not in str(error.value)


def test_a_learner_that_trains_is_waited_for(endpoint: str) -> None:
    """Its statuses are signs of life; its answer comes three deadlines later."""
    trained = threading.Event()

    def answer(side: LearnerLockstep, question: Observation) -> None:
        if trained.is_set():
            side.answer(_act(question))

    deadline = 1.0
    with (
        _bus(endpoint, answer, deadline) as (host, learners, _, _),
        contextmanager(_beating)(learners),
    ):
        timer = threading.Timer(3 * deadline, trained.set)
        timer.start()
        assert len(host.ask(_questions(0), acting=True)) == 2


def _beating(learners: Learners) -> Iterator[None]:
    beats = [
        Heartbeat(
            session, KEYS, agent.name, Rejections(), lambda a=agent: Status(a.name, "offline")
        )
        for session, agent in zip(learners._sessions, AGENTS, strict=True)
    ]
    for beat in beats:
        beat.__enter__()
    yield
    for beat in beats:
        beat.__exit__()


def test_a_flood_of_garbage_neither_fills_memory_nor_stops_the_run(endpoint: str) -> None:
    with _bus(endpoint, lambda side, question: side.answer(_act(question))) as bus:
        host, learners, session, rejections = bus
        put = session.publisher(KEYS.observation("agent_0"))
        garbage = learners._sessions[1].publisher(KEYS.action("agent_0"))
        for step in range(20):
            for _ in range(200):
                put(b"\x93garbage")
                garbage(b"\x93garbage")
            host.ask(_questions(step), acting=True)
        assert learners.rejections[0]["malformed"] > 0
        assert rejections["malformed"] > 0


def test_keys_name_the_run_and_nothing_that_zenoh_would_interpret() -> None:
    keys = Keys("a run/with*odd$characters?", "digest")
    for key in keys.learner_uses("agent_0").keys | keys.host_uses(["agent_0"]).keys:
        assert not set(key) & set("*$?# ")
        assert key.startswith("otc/a_run_with_odd_characters_/")
