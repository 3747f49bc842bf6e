"""Endpoints of each test's own."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from otc_dist.bus.endpoints import local_endpoint, remove_local_endpoint


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[str]:
    made = local_endpoint(tmp_path)
    yield made
    remove_local_endpoint(made)


def free_port() -> int:
    """A TCP port that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port
