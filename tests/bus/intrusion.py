"""An intruder with a learner's certificate, and all that it can try with Zenoh."""

import os
import queue
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from otc_dist.bus.endpoints import parse_endpoint
from otc_dist.bus.keys import HOST, Keys
from otc_dist.bus.links import QUICK_PAYLOAD, configuration, zenoh

from .conftest import free_port

PATIENCE = 10.0  # seconds; only a test that fails waits as long
KEYS, AGENTS = Keys("a-run", "digest"), ("agent_0", "agent_1")
MARK = b"mark"  # of what is allowed
REMOTE = zenoh.Locality.REMOTE
OWN = KEYS.learner_uses("agent_1")
EVERYTHING = KEYS.host_uses(AGENTS).keys | KEYS.learner_uses("agent_0").keys
WIDE = (
    "**",
    "otc/**",
    "otc/a-run/*/*",
    "otc/a-run/*/*/*",
    "otc/*/*/agent_0/**",
    "otc/a-run/digest/agent$*/observation",
    "@/**",
)


def direct(callback: Callable[[Any], None]) -> Any:
    """Called by Zenoh's own thread, so that it has been called once what follows has arrived."""
    return zenoh.handlers.Callback(callback, indirect=False)


class Bus:
    """An env host, agent_0 and an intruder with agent_1's certificate, as bare Zenoh sessions.

    All meet at the host, or at a router of somebody else's. The host watches all that enters, or
    with a router, which has rules for it too, host and victim watch each of the run's keys. The
    host answers every query.

    Args:
        access: the rules where all meet; None: there are none.
    """

    def __init__(
        self, folder: Path, closing: ExitStack, access: dict[str, object] | None, router: bool
    ) -> None:
        endpoint = f"tls/127.0.0.1:{free_port()}"

        def opened(name: str, mode: str, **settings: object) -> Any:
            identity = parse_endpoint(endpoint, name, folder, insecure=False)
            config = configuration(mode, QUICK_PAYLOAD, {**identity.settings, **settings})
            return closing.enter_context(zenoh.open(config))

        listening = {"listen/endpoints": [endpoint]}
        allowed = {} if access is None else {"access_control": access}
        connecting = {"connect/endpoints": [endpoint]}
        centre = opened(HOST, "router", **listening, **allowed)
        self.host = opened(HOST, "client", **connecting) if router else centre
        self.victim = opened("agent_0", "client", **connecting)
        self.intruder = opened("agent_1", "client", **connecting)
        self.entered: list[tuple[str, str]] = []  # what was done, on which key
        self.kept: list[Any] = []
        self._there: queue.Queue[bytes] = queue.Queue()
        self._back: queue.Queue[bytes] = queue.Queue()
        self._of_victim: queue.Queue[bytes] = queue.Queue()
        for session in (self.host, self.victim) if router else (self.host,):
            for key in sorted(EVERYTHING) if router else ("**",):
                watch, tokens = self._noting("sample"), session.liveliness()
                self.keep(session.declare_subscriber(key, watch, allowed_origin=REMOTE))
                self.keep(tokens.declare_subscriber(key, self._noting("token"), history=True))
        self.keep(self.host.declare_subscriber(KEYS.action("agent_1"), self._marks(self._there)))
        victims = KEYS.action("agent_0")
        self.keep(self.host.declare_subscriber(victims, self._marks(self._of_victim)))
        own = KEYS.observation("agent_1")
        self.keep(self.intruder.declare_subscriber(own, self._marks(self._back)))
        for key in sorted(EVERYTHING) if router else ("**",):
            self.keep(self.host.declare_queryable(key, self._answer))
        self.keep(self.host.liveliness().declare_token(KEYS.alive(HOST)))
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


ATTACKS: dict[str, Callable[[Bus, Sequence[str]], set[str]]] = {
    "put": _put,
    "delete": _delete,
    "subscribe": _subscribe,
    "query": _query,
    "queryable": _answer,
    "liveliness token": _show_token,
    "liveliness subscription": _watch_tokens,
    "liveliness query": _query_tokens,
}
