"""A learner's certificate opens its own keys, whatever is tried with it; nothing else does."""

import json
import os
import queue
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from otc_dist import certs
from otc_dist.bus.access import host_rules, router_rules
from otc_dist.bus.endpoints import door
from otc_dist.bus.keys import HOST, OBSERVER, Keys
from otc_dist.bus.links import QUICK_PAYLOAD, configuration, zenoh
from otc_dist.bus.session import Session

from .conftest import free_port

PATIENCE = 10.0  # seconds; only a test that fails waits as long
KEYS, AGENTS = Keys("a-run"), ("agent_0", "agent_1")
MARK = b"mark"  # of what is allowed
REMOTE = zenoh.Locality.REMOTE
OWN = KEYS.learner_uses("agent_1")
EVERYTHING = KEYS.host_uses(AGENTS).keys | KEYS.learner_uses("agent_0").keys
WIDE = (
    "**",
    "otc/**",
    "otc/a-run/*/*",
    "otc/*/agent_0/**",
    "otc/a-run/agent$*/observation",
    "@/**",
)


def direct(callback: Callable[[Any], None]) -> Any:
    """Called by Zenoh's own thread, so that it has been called once what follows has arrived."""
    return zenoh.handlers.Callback(callback, indirect=False)


class Bus:
    """An env host, agent_0 and an intruder with agent_1's certificate, as bare Zenoh sessions.

    The host watches all that enters; it answers every query and publishes on every key.
    """

    def __init__(self, folder: Path, closing: ExitStack, access: dict[str, object] | None) -> None:
        endpoint = f"tls/127.0.0.1:{free_port()}"

        def opened(name: str, mode: str, **settings: object) -> Any:
            identity = door(endpoint, name, folder, insecure=False)
            config = configuration(mode, QUICK_PAYLOAD, {**identity.settings, **settings})
            return closing.enter_context(zenoh.open(config))

        listening = {"listen/endpoints": [endpoint]}
        allowed = {} if access is None else {"access_control": access}
        self.host = opened(HOST, "router", **listening, **allowed)
        self.victim = opened("agent_0", "client", **{"connect/endpoints": [endpoint]})
        self.intruder = opened("agent_1", "client", **{"connect/endpoints": [endpoint]})
        self.entered: list[tuple[str, str]] = []  # what was done, on which key
        self.kept: list[Any] = []
        self._there: queue.Queue[bytes] = queue.Queue()
        self._back: queue.Queue[bytes] = queue.Queue()
        self._of_victim: queue.Queue[bytes] = queue.Queue()
        watch = self._noting("sample")
        self.keep(self.host.declare_subscriber("**", watch, allowed_origin=REMOTE))
        self.keep(self.host.declare_subscriber(KEYS.action("agent_1"), self._marks(self._there)))
        victims = KEYS.action("agent_0")
        self.keep(self.host.declare_subscriber(victims, self._marks(self._of_victim)))
        own = KEYS.observation("agent_1")
        self.keep(self.intruder.declare_subscriber(own, self._marks(self._back)))
        self.keep(self.host.declare_queryable("**", self._answer))
        tokens = self.host.liveliness()
        self.keep(tokens.declare_subscriber("**", self._noting("token"), history=True))
        self.keep(tokens.declare_token(KEYS.alive(HOST)))
        self.keep(self.victim.liveliness().declare_token(KEYS.alive("agent_0")))
        self.flush()

    def keep(self, declared: Any) -> None:
        """Undeclared with the sessions."""
        self.kept.append(declared)

    def _noting(self, what: str) -> Any:
        def note(sample: Any) -> None:
            if not sample.payload.to_bytes().startswith(MARK):
                self.entered.append((what, str(sample.key_expr)))

        return direct(note)

    @staticmethod
    def _marks(arrived: "queue.Queue[bytes]") -> Any:
        return direct(lambda sample: arrived.put(sample.payload.to_bytes()))

    def _answer(self, query: Any) -> None:
        with query:
            self.entered.append(("query", str(query.key_expr)))
            query.reply(KEYS.spec, b"a secret")

    def flush(self) -> None:
        """Return when all that both have sent has entered, and all sent to the intruder has come.

        Links keep the order, so it is enough to send what is allowed after it, there and back.
        """
        victims = KEYS.action("agent_0")
        _until_it_comes(lambda mark: self.victim.put(victims, mark), self._of_victim)
        _until_it_comes(lambda mark: self.intruder.put(KEYS.action("agent_1"), mark), self._there)
        _until_it_comes(lambda mark: self.host.put(KEYS.observation("agent_1"), mark), self._back)

    def intrusions(self) -> set[str]:
        """Keys on which anything has entered that agent_1 has no right to do."""
        mine = {("sample", key) for key in OWN.publishes} | {("query", key) for key in OWN.asks}
        honest = {("token", KEYS.alive(name)) for name in (HOST, *AGENTS)}
        return {key for entry in self.entered if entry not in mine | honest for key in entry[1:]}


def _until_it_comes(put: Callable[[bytes], None], arrived: "queue.Queue[bytes]") -> None:
    """Send a mark until it arrives: before the other side's subscription is known, it is lost."""
    mark = MARK + os.urandom(8)
    for _ in range(100):
        put(mark)
        with suppress(queue.Empty):
            while arrived.get(timeout=PATIENCE / 100) != mark:
                pass
            return
    raise AssertionError("what is allowed does not arrive")


@contextmanager
def _bus(folder: Path, access: dict[str, object] | None) -> Iterator[Bus]:
    with ExitStack() as closing:
        yield Bus(folder, closing, access)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("certs")
    list(certs.make(made, AGENTS, ["127.0.0.1"], days=30))
    return made


def _put(bus: Bus, keys: Sequence[str]) -> set[str]:
    for key in keys:
        bus.intruder.put(key, b"forged")
    bus.flush()
    return bus.intrusions()


def _delete(bus: Bus, keys: Sequence[str]) -> set[str]:
    for key in keys:
        bus.intruder.delete(key)
    bus.flush()
    return bus.intrusions()


def _subscribe(bus: Bus, keys: Sequence[str]) -> set[str]:
    heard: set[str] = set()
    note = direct(lambda sample: heard.add(str(sample.key_expr)))
    for key in keys:
        bus.keep(bus.intruder.declare_subscriber(key, note, allowed_origin=REMOTE))
    bus.flush()
    for key in EVERYTHING:
        bus.host.put(key, b"private")
    for key in KEYS.learner_uses("agent_0").publishes:
        bus.victim.put(key, b"private")
    bus.flush()
    return heard - set(OWN.hears)


def _query(bus: Bus, keys: Sequence[str]) -> set[str]:
    asked = [(key, bus.intruder.get(key, timeout=0.5, allowed_destination=REMOTE)) for key in keys]
    answered = {key for key, replies in asked for reply in replies if reply.ok is not None}
    return answered - set(OWN.asks) | bus.intrusions()


def _answer(bus: Bus, keys: Sequence[str]) -> set[str]:
    asked: set[str] = set()

    def on_query(query: Any) -> None:
        with query:
            asked.add(str(query.key_expr))

    for key in keys:
        bus.keep(bus.intruder.declare_queryable(key, direct(on_query)))
    bus.flush()
    for key in EVERYTHING:
        list(bus.host.get(key, timeout=0.5))
    for key in KEYS.learner_uses("agent_0").asks:
        list(bus.victim.get(key, timeout=0.5))
    return asked


def _show_token(bus: Bus, keys: Sequence[str]) -> set[str]:
    bus.entered.clear()
    for key in keys:
        bus.keep(bus.intruder.liveliness().declare_token(key))
    bus.flush()
    # The honest ones have been seen before: once more means that somebody poses as them.
    return {key for what, key in bus.entered if what == "token"} - set(OWN.shows)


def _watch_tokens(bus: Bus, keys: Sequence[str]) -> set[str]:
    seen: set[str] = set()
    tokens = bus.intruder.liveliness()
    note = direct(lambda sample: seen.add(str(sample.key_expr)))
    for key in keys:
        bus.keep(tokens.declare_subscriber(key, note, history=True))
    bus.flush()
    return seen - set(OWN.watches)


def _query_tokens(bus: Bus, keys: Sequence[str]) -> set[str]:
    asked = [bus.intruder.liveliness().get(key, timeout=0.5) for key in keys]
    found = {str(reply.ok.key_expr) for replies in asked for reply in replies if reply.ok}
    return found - set(OWN.watches)


ATTACKS = {
    "put": _put,
    "delete": _delete,
    "subscribe": _subscribe,
    "query": _query,
    "queryable": _answer,
    "liveliness token": _show_token,
    "liveliness subscription": _watch_tokens,
    "liveliness query": _query_tokens,
}
Attack = Callable[[Bus, Sequence[str]], set[str]]


@pytest.mark.parametrize("attack", ATTACKS.values(), ids=list(ATTACKS))
def test_agent_1_gets_nothing_of_agent_0_and_of_the_host(folder: Path, attack: Attack) -> None:
    with _bus(folder, host_rules(KEYS, AGENTS)) as bus:
        assert attack(bus, [*sorted(EVERYTHING - OWN.keys), *_shared(), *WIDE]) == set()


@pytest.mark.parametrize("attack", ATTACKS.values(), ids=list(ATTACKS))
def test_the_same_attack_succeeds_where_there_are_no_rules(folder: Path, attack: Attack) -> None:
    with _bus(folder, None) as bus:
        assert attack(bus, sorted(EVERYTHING - OWN.keys)) != set()


def _shared() -> list[str]:
    """Keys of the host that every learner may read, and none write."""
    return [KEYS.spec, KEYS.status(HOST), KEYS.alive(HOST)]


def test_through_a_router_with_rules_passes_what_a_run_needs(folder: Path) -> None:
    """The rules are those that the command prints, put into somebody else's router."""
    endpoint = f"tls/127.0.0.1:{free_port()}"

    def opened(name: str) -> Session:
        at = door(endpoint, name, folder, insecure=False)
        return closing.enter_context(Session.connect(at, QUICK_PAYLOAD, PATIENCE))

    with ExitStack() as closing:
        config = zenoh.Config()
        settings = {
            "mode": "router",
            "listen/endpoints": [endpoint],
            "access_control": router_rules(KEYS, AGENTS),
            **door(endpoint, HOST, folder, insecure=False).settings,
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        closing.enter_context(zenoh.open(config))
        host, learner, observer = map(opened, (HOST, "agent_1", OBSERVER))
        arrived: set[str] = set()

        def hear(session: Session, key: str, label: str) -> None:
            session.subscribe(key, lambda payload: arrived.add(label))

        status = KEYS.status("agent_1")
        hear(host, KEYS.action("agent_1"), "action")
        hear(host, status, "status")
        hear(observer, status, "status at the launcher")
        hear(learner, KEYS.observation("agent_1"), "observation")
        hear(learner, KEYS.status(HOST), "the host's status")
        host.answer(KEYS.spec, lambda _: b"spec")
        host.answer(KEYS.history("agent_1"), lambda _: b"history")
        host.watch_alive(KEYS.alive("agent_1"), lambda alive: arrived.add("token"))
        learner.watch_alive(KEYS.alive(HOST), lambda alive: arrived.add("the host's token"))
        observer.watch_alive(KEYS.alive(HOST), lambda alive: arrived.add("token at the launcher"))
        host.declare_alive(KEYS.alive(HOST))
        learner.declare_alive(KEYS.alive("agent_1"))
        puts = [learner.publisher(key) for key in (KEYS.action("agent_1"), status)]
        puts += [host.publisher(key) for key in (KEYS.observation("agent_1"), KEYS.status(HOST))]
        end = time.monotonic() + PATIENCE
        while len(arrived) < 8 and time.monotonic() < end:
            for put in puts:
                put(b"something")
            for key in OWN.asks:  # also the time in which the rest arrives
                if learner.ask(key, {}, timeout=1.0) is None:
                    arrived.discard("action")
        assert arrived == {
            "action",
            "status",
            "status at the launcher",
            "observation",
            "the host's status",
            "token",
            "the host's token",
            "token at the launcher",
        }
