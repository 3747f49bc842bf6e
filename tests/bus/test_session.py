"""Sessions: private, bounded, and clear about what is wrong."""

import multiprocessing
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from otc_dist.bus import handshake
from otc_dist.bus.endpoints import Endpoint
from otc_dist.bus.handshake import agree, claim, offer
from otc_dist.bus.keys import Keys
from otc_dist.bus.links import QUICK_PAYLOAD, configuration, zenoh
from otc_dist.bus.lockstep import GaveUpError, HostLockstep, LearnerLockstep
from otc_dist.bus.messages import Action, Moment, Observation
from otc_dist.bus.replies import RunSpec
from otc_dist.bus.session import Session
from otc_dist.bus.wire import Rejections
from otc_dist.spec import AgentSpec
from otc_dist.terminal.errors import UserError

PATIENCE = 60.0  # seconds; only a test that fails waits as long


def test_a_used_port_is_one_clear_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(UserError, match="in use") as error:
            Session.listen([Endpoint(endpoint)], 1024)
    assert "\n" not in str(error.value)


def test_a_second_host_of_the_same_run_is_refused(endpoint: str) -> None:
    with Session.listen([Endpoint(endpoint)], 1024), pytest.raises(UserError, match="in use"):
        Session.listen([Endpoint(endpoint)], 1024)


def test_a_killed_host_leaves_nothing_that_stops_the_next(endpoint: str) -> None:
    path = Path(endpoint.removeprefix("unixsock-stream/"))
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    with Session.listen([Endpoint(endpoint)], 1024):
        Session.connect(Endpoint(endpoint), 1024, timeout=PATIENCE).close()


def test_nobody_listening_is_one_clear_line(endpoint: str) -> None:
    with pytest.raises(UserError, match="nobody listens") as error:
        Session.connect(Endpoint(endpoint), 1024, timeout=0.2)
    assert "\n" not in str(error.value)


def test_payloads_beyond_the_cap_do_not_arrive(endpoint: str) -> None:
    received: queue.Queue[int] = queue.Queue()
    with (
        Session.listen([Endpoint(endpoint)], 2048) as host,
        Session.connect(Endpoint(endpoint), 2048) as client,
    ):
        host.subscribe("a/key", lambda payload: received.put(len(payload)))
        # The client learns of the subscription through its connection; a query comes after it.
        host.answer("b/key", lambda _: b"")
        while client.ask("b/key", {}, PATIENCE) is None:
            pass
        put = client.publisher("a/key")
        for size in (10, 4096, 2000):
            put(b"x" * size)
        assert [received.get(timeout=PATIENCE) for _ in range(2)] == [10, 2000]


def test_queries_carry_parameters_and_refusals(endpoint: str) -> None:
    def reply(parameters: object) -> bytes:
        if parameters == {"wrong": "1"}:
            raise LookupError("no such thing")
        return repr(parameters).encode()

    with (
        Session.listen([Endpoint(endpoint)], 2048) as host,
        Session.connect(Endpoint(endpoint), 2048) as client,
    ):
        host.answer("a/key", reply)
        answer = None
        while answer is None:
            answer = client.ask("a/key", {"deployment": "3", "start": "0"}, PATIENCE)
        assert answer == b"{'deployment': '3', 'start': '0'}"
        with pytest.raises(LookupError, match="no such thing"):
            client.ask("a/key", {"wrong": "1"}, PATIENCE)


def test_a_learner_of_another_description_is_told_so(endpoint: str) -> None:
    keys, agents = Keys("a-run", "theirs"), (AgentSpec("agent_0", 3, (-1.0,), (1.0,)),)
    with (
        Session.listen([Endpoint(endpoint)], 2048) as host,
        Session.connect(Endpoint(endpoint), 2048) as s,
    ):
        offer(host, keys, RunSpec("an-env", agents, "theirs"))
        agree(s, keys, RunSpec("an-env", agents, "theirs"), PATIENCE, Rejections())
        for mine, says in (
            (RunSpec("an-env", agents, "mine"), "runs another description (theirs) than this"),
            (RunSpec("an-env", agents * 2, "theirs"), "install the same version"),
        ):
            with pytest.raises(UserError) as refused:
                agree(s, keys, mine, PATIENCE, Rejections())
            assert says in str(refused.value) and "\n" not in str(refused.value)
        with pytest.raises(
            UserError, match="no env host of run 'another-run' answered for 0 s: do"
        ):
            agree(s, Keys("another-run", ""), RunSpec("", (), ""), 0.0, Rejections())


def test_env_hosts_of_one_name_at_one_router_are_heard_by_their_own_learners_alone(
    endpoint: str,
) -> None:
    """As of two people who run the same job, by other settings."""
    agents = (AgentSpec("agent_0", 3, (-1.0,), (1.0,)),)
    copies, phase = {"evaluation": 1}, Moment("evaluation", 0, 1, 0)
    question = Observation(phase, np.zeros((1, 3), np.float32), None)
    with ExitStack() as closing:
        closing.enter_context(Session.listen([Endpoint(endpoint)], 2048))

        def client() -> Session:
            return closing.enter_context(Session.connect(Endpoint(endpoint), 2048, PATIENCE))

        hosts, sides = {}, {}
        for mine in ("ours", "theirs"):
            keys, spec = Keys("a-run", mine), RunSpec("an-env", agents, mine)
            session = client()
            claim(session, keys)
            offer(session, keys, spec)
            session.declare_alive(keys.alive("host"))
            hosts[mine] = HostLockstep(session, keys, agents, copies, PATIENCE, Rejections())
            session = client()
            agree(session, keys, spec, PATIENCE, Rejections(), shared=True)
            sides[mine] = LearnerLockstep(session, keys, agents[0], copies, Rejections())
        asking = threading.Thread(
            target=hosts["theirs"].ask, args=([question],), kwargs={"acting": True}
        )
        asking.start()
        while sides["theirs"].question(1.0) is None:
            pass
        assert sides["ours"].question(0.1) is None
        action = Action(phase, np.zeros((1, 1), np.float32), "0" * 16)
        sides["ours"].answer(action)
        asking.join(0.2)
        assert asking.is_alive()
        sides["theirs"].answer(action)
        asking.join(PATIENCE)
        assert not asking.is_alive()


def test_a_second_env_host_of_the_very_same_run_at_a_router_is_refused(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(handshake, "_LEAVING", 0.1)
    keys = Keys("a-run", "digest")
    with (
        Session.listen([Endpoint(endpoint)], 2048),
        Session.connect(Endpoint(endpoint), 2048) as second,
    ):
        with Session.connect(Endpoint(endpoint), 2048) as first:
            claim(first, keys)
            first.declare_alive(keys.alive("host"))
            end = time.monotonic() + PATIENCE
            while not second.is_alive(keys.alive("host"), PATIENCE):  # it is on its way
                assert time.monotonic() < end
            with pytest.raises(GaveUpError, match="another env host of run 'a-run' is at work"):
                claim(second, keys)
        claim(second, keys)  # once it has gone


def test_liveliness_is_seen_to_come_and_to_go(endpoint: str) -> None:
    seen: queue.Queue[bool] = queue.Queue()
    with Session.listen([Endpoint(endpoint)], 2048) as host:
        host.watch_alive("alive/x", seen.put)
        client = Session.connect(Endpoint(endpoint), 2048)
        client.declare_alive("alive/x")
        assert seen.get(timeout=PATIENCE) is True
        client.close()
        assert seen.get(timeout=PATIENCE) is False


def _freeze(endpoint: str) -> None:
    with Session.connect(Endpoint(endpoint), QUICK_PAYLOAD) as session:
        session.inbox("t/question")
        session.declare_alive("t/alive")
        os.kill(os.getpid(), signal.SIGSTOP)


def test_a_frozen_process_never_holds_up_who_asks_it_again(endpoint: str) -> None:
    present, gone = threading.Event(), threading.Event()
    with Session.listen([Endpoint(endpoint)], QUICK_PAYLOAD) as session:
        session.watch_alive("t/alive", lambda alive: (present if alive else gone).set())
        put = session.publisher("t/question")
        frozen = multiprocessing.get_context("spawn").Process(target=_freeze, args=(endpoint,))
        frozen.start()
        try:
            assert present.wait(PATIENCE)
            longest, asked = 0.0, 0
            # More often than a lock-step repeats its question; the lease ends the link.
            while not gone.wait(0.25) and asked < 40:
                start = time.monotonic()
                put(bytes(QUICK_PAYLOAD - 200))
                longest, asked = max(longest, time.monotonic() - start), asked + 1
        finally:
            frozen.kill()
            frozen.join()
        assert gone.is_set() and longest < 0.2


@pytest.mark.parametrize(("host", "client"), [(QUICK_PAYLOAD, 2**20), (2**20, QUICK_PAYLOAD)])
def test_quick_and_ordinary_sessions_understand_each_other(
    endpoint: str, host: int, client: int
) -> None:
    with (
        Session.listen([Endpoint(endpoint)], host) as one,
        Session.connect(Endpoint(endpoint), client) as other,
    ):
        page = b"x" * QUICK_PAYLOAD
        one.answer("t/page", lambda _: page)
        while (answer := other.ask("t/page", {}, PATIENCE)) is None:
            pass
        assert answer == page


CENTRE = """
import sys
from otc_dist.bus.endpoints import Endpoint
from otc_dist.bus.session import Session

def peak():
    return next(int(x.split()[1]) for x in open("/proc/self/status") if x.startswith("VmHWM"))

with Session.listen([Endpoint(sys.argv[1])], int(sys.argv[2])) as session:
    session.answer("a/key", lambda _: str(peak()).encode())
    print("up", flush=True)
    sys.stdin.read()
"""


@pytest.mark.parametrize("limit", [16_000, 2**20])
def test_a_message_beyond_the_cap_is_not_put_together(endpoint: str, limit: int) -> None:
    """The host's memory, as it tells it, before and after a hostile client's large queries."""
    command = [sys.executable, "-c", CENTRE, endpoint, str(limit)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as centre:
        assert centre.stdout is not None and centre.stdout.readline() == b"up\n"
        client = zenoh.open(configuration("client", 2**30, {"connect/endpoints": [endpoint]}))

        def peak() -> int:  # answered after all that was sent before it
            (reply,) = client.get("a/key", timeout=30.0)
            return int(reply.ok.payload.to_bytes())

        before = peak()
        for _ in range(2):
            client.get("a/key", payload=bytes(2**26), timeout=0.1)
            assert peak() - before < 2**14  # KiB: it was 64 MiB long
        client.close()
