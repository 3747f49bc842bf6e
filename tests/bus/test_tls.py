"""Across hosts: mutual TLS or a clear refusal within five seconds."""

import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import datetime, timedelta, tzinfo
from pathlib import Path

import pytest

from otc_dist.bus.access import host_rules
from otc_dist.bus.diagnosis import refusal
from otc_dist.bus.endpoints import Endpoint, parse_endpoint
from otc_dist.bus.identity import AUTHORITY, CERTIFICATE, KEY, Identity
from otc_dist.bus.keys import HOST, OBSERVER, Keys
from otc_dist.bus.links import QUICK_PAYLOAD, configuration, zenoh
from otc_dist.bus.session import Session
from otc_dist.certs import authority
from otc_dist.terminal.errors import UserError

from .conftest import free_port

AGENTS = ("agent_0", "agent_1")
QUICKLY = 5.0  # seconds within which a refusal is clear
PATIENCE = 30.0


def _make(folder: Path, *names: str, days: float = 30) -> Path:
    list(authority.make(folder, AGENTS, names or ("127.0.0.1",), days))
    return folder


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _make(tmp_path_factory.mktemp("ours"))


@pytest.fixture(scope="module")
def theirs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of another authority."""
    return _make(tmp_path_factory.mktemp("theirs"))


@pytest.fixture(scope="module")
def expired(tmp_path_factory: pytest.TempPathFactory, ours: Path) -> Path:
    """Of our authority, from yesterday until noon, say."""
    folder = tmp_path_factory.mktemp("expired")
    shutil.copytree(ours / "authority", folder / "authority")
    return _make(folder, days=-0.5)


@pytest.fixture(scope="module")
def listening(ours: Path) -> Iterator[str]:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    with Session.listen([parse_endpoint(endpoint, HOST, ours, insecure=False)], QUICK_PAYLOAD):
        yield endpoint


def _files(folder: Path, process: str, authority: Path | None = None) -> Identity:
    """An identity that nobody has checked."""
    own = folder / process
    return Identity((authority or own) / AUTHORITY, own / CERTIFICATE, own / KEY)


class _LastYear(datetime):
    """A clock that is wrong."""

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> datetime:
        return datetime.now(tz) - timedelta(days=365)


def _refusal(attempt: Callable[[], object]) -> str:
    start = time.monotonic()
    with pytest.raises(UserError) as refused:
        attempt()
    assert time.monotonic() - start < QUICKLY
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_who_holds_a_certificate_of_the_same_authority_is_let_in(
    listening: str, ours: Path
) -> None:
    for process in (*AGENTS, OBSERVER):
        Session.connect(
            parse_endpoint(listening, process, ours, insecure=False), QUICK_PAYLOAD
        ).close()


def test_the_launcher_looks_on_through_the_socket_of_its_machine(ours: Path, endpoint: str) -> None:
    keys = Keys("a-run", "digest")
    outside, local = f"tls/127.0.0.1:{free_port()}", Endpoint(endpoint)
    endpoints = [parse_endpoint(outside, HOST, ours, insecure=False), local]
    rules = host_rules(keys, AGENTS)
    heard: list[bytes] = []
    learner = parse_endpoint(outside, "agent_1", ours, insecure=False)
    with (
        Session.listen(endpoints, QUICK_PAYLOAD, rules) as host,
        Session.connect(local, QUICK_PAYLOAD) as launcher,
        Session.connect(learner, QUICK_PAYLOAD) as session,
    ):
        inbox = launcher.inbox(keys.status("agent_1"))
        launcher.subscribe(keys.action("agent_1"), heard.append)  # not its business
        put, private = (
            session.publisher(key) for key in (keys.status("agent_1"), keys.action("agent_1"))
        )
        at_host = host.inbox(keys.action("agent_1"))
        end = time.monotonic() + PATIENCE
        while (status := inbox.look()) is None and time.monotonic() < end:
            private(b"an action")
            put(b"a status")
            at_host.get(time.monotonic() + 0.1)
        assert status == b"a status"
        assert heard == []


def test_another_authority_is_refused_by_both_sides(
    listening: str, ours: Path, theirs: Path
) -> None:
    stranger = parse_endpoint(listening, "agent_1", theirs, insecure=False)
    message = _refusal(lambda: Session.connect(stranger, QUICK_PAYLOAD, PATIENCE))
    assert f"the certificate of {listening} is refused" in message
    # Even who has got hold of our authority's certificate, which is no secret, is refused.
    pretender = Endpoint(listening, _files(theirs, "agent_1", authority=ours / "agent_1"))
    message = _refusal(lambda: Session.connect(pretender, QUICK_PAYLOAD, PATIENCE))
    assert "trusts another authority than the one that issued our certificate" in message


def test_an_expired_certificate_is_refused_by_both_sides(
    listening: str, ours: Path, expired: Path
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("otc_dist.bus.identity.datetime", _LastYear)
        early = _refusal(lambda: parse_endpoint(listening, "agent_1", ours, insecure=False))
    assert "on: is this machine's clock right?" in early
    assert "expired on" in _refusal(
        lambda: parse_endpoint(listening, "agent_1", expired, insecure=False)
    )
    late = Endpoint(listening, _files(expired, "agent_1"))
    message = _refusal(lambda: Session.connect(late, QUICK_PAYLOAD, PATIENCE))
    assert "says that our certificate has expired" in message
    endpoint = f"tls/127.0.0.1:{free_port()}"
    learner = parse_endpoint(endpoint, "agent_1", ours, insecure=False)
    with Session.listen([Endpoint(endpoint, _files(expired, HOST))], QUICK_PAYLOAD):
        message = _refusal(lambda: Session.connect(learner, QUICK_PAYLOAD, PATIENCE))
    assert "certificate has expired" in message


def test_no_certificate_is_no_way_in(listening: str, ours: Path) -> None:
    assert "needs --certs DIR" in _refusal(
        lambda: parse_endpoint(listening, "agent_1", None, insecure=False)
    )
    # Not even for who speaks Zenoh and trusts our authority.
    settings = {
        "transport/link/tls/root_ca_certificate": str(ours / "agent_1" / AUTHORITY),
        "connect/endpoints": [listening],
        "connect/timeout_ms": 1000,
        "connect/exit_on_failure": True,
    }
    start = time.monotonic()
    with pytest.raises(zenoh.ZError):
        zenoh.open(configuration("client", QUICK_PAYLOAD, settings))
    assert time.monotonic() - start < QUICKLY


def test_plaintext_is_refused_by_both_sides(listening: str, ours: Path) -> None:
    plain = listening.replace("tls/", "tcp/")
    message = _refusal(lambda: Session.connect(Endpoint(plain), QUICK_PAYLOAD, PATIENCE))
    assert f"use {listening} with --certs" in message
    plain = f"tcp/127.0.0.1:{free_port()}"
    learner = parse_endpoint(plain.replace("tcp/", "tls/"), "agent_1", ours, insecure=False)
    with Session.listen([Endpoint(plain)], QUICK_PAYLOAD):
        message = _refusal(lambda: Session.connect(learner, QUICK_PAYLOAD, PATIENCE))
    assert "does not speak TLS: does it run with --insecure?" in message


def test_a_host_that_dies_during_the_greeting_is_waited_for(ours: Path) -> None:
    """It is no refusal, so that a supervisor may start it again meanwhile."""
    with socket.create_server(("127.0.0.1", 0)) as dying:
        endpoint = f"tls/127.0.0.1:{dying.getsockname()[1]}"

        def hang_up() -> None:
            with suppress(OSError):
                while True:
                    dying.accept()[0].close()

        threading.Thread(target=hang_up, daemon=True).start()
        assert refusal(parse_endpoint(endpoint, "agent_0", ours, insecure=False)) is None
        dying.shutdown(socket.SHUT_RDWR)


def test_a_learner_cannot_pose_as_the_env_host(ours: Path) -> None:
    endpoint = f"tls/127.0.0.1:{free_port()}"
    learner = parse_endpoint(endpoint, "agent_0", ours, insecure=False)
    with Session.listen([Endpoint(endpoint, _files(ours, "agent_1"))], QUICK_PAYLOAD):
        message = _refusal(lambda: Session.connect(learner, QUICK_PAYLOAD, PATIENCE))
    assert "is refused" in message


def test_a_host_by_another_name_is_refused(ours: Path, tmp_path: Path) -> None:
    elsewhere = _make(tmp_path / "certs", "learners.example.org")
    endpoint = f"tls/127.0.0.1:{free_port()}"
    with Session.listen([parse_endpoint(endpoint, HOST, elsewhere, insecure=False)], QUICK_PAYLOAD):
        learner = parse_endpoint(endpoint, "agent_0", elsewhere, insecure=False)
        message = _refusal(lambda: Session.connect(learner, QUICK_PAYLOAD, PATIENCE))
    assert "127.0.0.1" in message and "is refused" in message


@pytest.mark.parametrize(
    ("endpoint", "insecure", "certificates", "says"),
    [
        ("10.0.0.1:7447", False, True, "write it as tls/192.0.2.1:7447"),
        ("tls/10.0.0.1", False, True, "has no port"),
        ("tcp/10.0.0.1:7447", False, False, "use tls/10.0.0.1:7447 with --certs DIR, or use --ins"),
        ("udp/10.0.0.1:7447", False, True, "is open to everybody"),
        ("tls/:7447", False, True, "the host in 'tls/:7447' is not a host name or an IP address"),
        ("tls/::1:7447", False, True, "or tls/[2001:db8::1]:7447"),
        ("tls/10.0.0.1:7447", False, False, "needs --certs DIR"),
        ("tcp/10.0.0.1:7447", True, True, "contradict each other"),
    ],
)
def test_a_door_that_nobody_should_use(
    endpoint: str, insecure: bool, certificates: bool, says: str, ours: Path
) -> None:
    assert says in _refusal(
        lambda: parse_endpoint(endpoint, "agent_0", ours if certificates else None, insecure)
    )


def test_certificates_that_cannot_serve(ours: Path, theirs: Path, tmp_path: Path) -> None:
    endpoint = "tls/127.0.0.1:7447"

    def refused_with(change: Callable[[Path], object]) -> str:
        folder = tmp_path / str(time.monotonic_ns())
        shutil.copytree(ours, folder)
        change(folder / "agent_0")
        return _refusal(lambda: parse_endpoint(endpoint, "agent_0", folder, insecure=False))

    assert "is missing; python -m otc_dist.certs" in refused_with(lambda own: (own / KEY).unlink())
    assert "no certificate of agent_7" in _refusal(
        lambda: parse_endpoint(endpoint, "agent_7", ours, False)
    )
    assert "is damaged" in refused_with(lambda own: (own / CERTIFICATE).write_text("nonsense"))
    for name, says in (
        (CERTIFICATE, "is agent_1's certificate, not agent_0's"),
        (KEY, "is not the key of"),
    ):
        other = ours / "agent_1" / name
        assert says in refused_with(lambda own, n=name, o=other: shutil.copy(o, own / n))
    foreign = theirs / "agent_0" / AUTHORITY
    assert "was not issued by" in refused_with(lambda own: shutil.copy(foreign, own / AUTHORITY))


def test_an_address_in_use_is_one_clear_line(ours: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = parse_endpoint(
            f"tls/127.0.0.1:{server.getsockname()[1]}", HOST, ours, insecure=False
        )
        assert "in use" in _refusal(lambda: Session.listen([taken], QUICK_PAYLOAD))
