"""A learner's certificate opens its own keys, whatever is tried with it; nothing else does."""

import json
import queue
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from otc_dist.bus.access import host_rules, router_rules
from otc_dist.bus.endpoints import Endpoint, parse_endpoint
from otc_dist.bus.keys import HOST, OBSERVER
from otc_dist.bus.links import QUICK_PAYLOAD, zenoh
from otc_dist.bus.session import Session
from otc_dist.certs import authority

from .conftest import free_port
from .intrusion import AGENTS, ATTACKS, EVERYTHING, KEYS, OWN, PATIENCE, WIDE, Bus

RULES = {"the env host": host_rules, "a router": router_rules}


@contextmanager
def _bus(folder: Path, centre: str, *, ruled: bool) -> Iterator[Bus]:
    rules = RULES[centre](KEYS, AGENTS) if ruled else None
    with ExitStack() as closing:
        yield Bus(folder, closing, rules, router=centre == "a router")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("certs")
    list(authority.make(made, AGENTS, ["127.0.0.1"], days=30))
    return made


@pytest.mark.parametrize("centre", RULES)
@pytest.mark.parametrize("attack", ATTACKS)
def test_agent_1_gets_nothing_of_agent_0_and_of_the_host(
    folder: Path, attack: str, centre: str
) -> None:
    with _bus(folder, centre, ruled=True) as bus:
        assert ATTACKS[attack](bus, [*sorted(EVERYTHING - OWN.keys), *_shared(), *WIDE]) == set()


@pytest.mark.parametrize("centre", RULES)
@pytest.mark.parametrize("attack", ATTACKS)
def test_the_same_attack_succeeds_where_there_are_no_rules(
    folder: Path, attack: str, centre: str
) -> None:
    with _bus(folder, centre, ruled=False) as bus:
        assert ATTACKS[attack](bus, sorted(EVERYTHING - OWN.keys)) != set()


def _shared() -> list[str]:
    """Keys of the host that every learner may read, and none write."""
    return [KEYS.spec, KEYS.status(HOST), KEYS.alive(HOST)]


@contextmanager
def _router(folder: Path, endpoint: str, rules: dict[str, object]) -> Iterator[None]:
    """Somebody else's router, with the rules that the command prints."""
    config = zenoh.Config()
    settings = {
        "mode": "router",
        "listen/endpoints": [endpoint],
        "access_control": rules,
        **parse_endpoint(endpoint, HOST, folder, insecure=False).settings,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        yield


@pytest.mark.parametrize("through", ["a router", "the env host", "the private socket"])
def test_who_only_looks_hears_statuses_and_nothing_else(
    folder: Path, endpoint: str, through: str
) -> None:
    at = f"tls/127.0.0.1:{free_port()}"
    named = {
        name: parse_endpoint(at, name, folder, insecure=False)
        for name in (HOST, "agent_1", OBSERVER)
    }
    with ExitStack() as closing:

        def connected(where: Endpoint) -> Session:
            return closing.enter_context(Session.connect(where, QUICK_PAYLOAD, PATIENCE))

        if through == "a router":
            closing.enter_context(_router(folder, at, router_rules(KEYS, AGENTS)))
            host = connected(named[HOST])
        else:
            endpoints, rules = [named[HOST], Endpoint(endpoint)], host_rules(KEYS, AGENTS)
            host = closing.enter_context(Session.listen(endpoints, QUICK_PAYLOAD, rules))
        learner = connected(named["agent_1"])
        observer = connected(Endpoint(endpoint) if "socket" in through else named[OBSERVER])

        heard: queue.Queue[bytes] = queue.Queue()
        entered: list[bytes] = []
        secret = [*(KEYS.observation(name) for name in AGENTS), KEYS.action("agent_1")]
        for key in (*secret, *WIDE, KEYS.status(HOST), KEYS.status("agent_1")):
            observer.subscribe(key, heard.put)
        for key in (KEYS.action("agent_1"), KEYS.status("agent_1")):
            host.subscribe(key, entered.append)
        learner.subscribe(KEYS.observation("agent_1"), entered.append)
        host.answer(KEYS.spec, lambda _: b"private")
        forging = [observer.publisher(key) for key in sorted(EVERYTHING | OWN.keys)]
        by_host = [host.publisher(KEYS.observation(name)) for name in AGENTS]
        by_learner = [learner.publisher(KEYS.action("agent_1"))]
        told = [host.publisher(KEYS.status(HOST)), learner.publisher(KEYS.status("agent_1"))]
        # Links keep the order: what may be heard comes after all that may not.
        awaited, found = {b"status 0", b"status 1"}, set()
        end = time.monotonic() + PATIENCE
        while not (awaited <= found and b"private" in entered) and time.monotonic() < end:
            for put in forging:
                put(b"forged")
            for put in (*by_host, *by_learner):
                put(b"private")
            for number, put in enumerate(told):
                put(b"status %d" % number)
            with suppress(queue.Empty):
                while True:
                    found.add(heard.get(timeout=0.05))
        assert found - {b"forged"} == awaited  # its own come back to it without a link
        assert b"private" in entered and b"forged" not in entered
        assert observer.ask(KEYS.spec, {}, timeout=0.5) is None


def test_through_a_router_with_rules_passes_what_a_run_needs(folder: Path) -> None:
    """The rules are those that the command prints, put into somebody else's router."""
    endpoint = f"tls/127.0.0.1:{free_port()}"

    def opened(name: str) -> Session:
        at = parse_endpoint(endpoint, name, folder, insecure=False)
        return closing.enter_context(Session.connect(at, QUICK_PAYLOAD, PATIENCE))

    with ExitStack() as closing:
        closing.enter_context(_router(folder, endpoint, router_rules(KEYS, AGENTS)))
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
