"""Who waits for a link knows for whom; the refusals themselves are in test_tls."""

import socket
from typing import Any

import pytest

from otc_dist.bus import session
from otc_dist.bus.diagnosis import absence, refusal
from otc_dist.bus.endpoints import Endpoint
from otc_dist.bus.links import QUICK_PAYLOAD
from otc_dist.terminal.errors import UserError

from .conftest import free_port


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_an_address_where_nobody_answers_is_said(protocol: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        there = f"{protocol}/127.0.0.1:{server.getsockname()[1]}"
        assert absence(Endpoint(there)) is None
    assert absence(Endpoint(there)) == (
        f"waiting for {there}: nobody answers there yet; start the env host (or the router), or"
        " check the address"
    )


def test_a_name_that_nobody_knows_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> None:
        raise socket.gaierror

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    said = absence(Endpoint("tls/learners.example.org:7447"))
    assert said is not None and "this machine does not know learners.example.org" in said


def test_of_the_socket_of_one_machine_nothing_is_said(endpoint: str) -> None:
    assert absence(Endpoint(endpoint)) is None and refusal(Endpoint(endpoint)) is None


def test_what_zenoh_cannot_link_to_is_refused_at_once() -> None:
    said = refusal(Endpoint("tls/[2001:db8::1]:7447"))
    assert said is not None and "Zenoh does not link to IPv6 addresses by TLS" in said


def test_who_comes_late_and_refuses_is_told_of_as_soon_as_who_was_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However long one has waited, it is asked again and again why there is no link."""
    tried: list[Any] = []

    def configuration(mode: str, maximum: int, settings: dict[str, object]) -> object:
        tried.append(settings["connect/timeout_ms"])
        return original(mode, maximum, settings)

    original = session.configuration
    monkeypatch.setattr(session, "configuration", configuration)
    monkeypatch.setattr(session, "_ATTEMPT", 0.01)
    monkeypatch.setattr(session, "_LONGEST_ATTEMPT", 0.05)
    monkeypatch.setattr(session, "refusal", lambda _: "refused" if len(tried) == 8 else None)
    with pytest.raises(UserError, match="refused"):
        session.Session.connect(Endpoint(f"tcp/127.0.0.1:{free_port()}"), QUICK_PAYLOAD, 600.0)
    assert tried == [10, 20, 40, 50, 50, 50, 50, 50]
