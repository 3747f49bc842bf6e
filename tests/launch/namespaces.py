"""Hosts of a network, as Linux network namespaces: a star of links around the first."""

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class Host:
    """A namespace. `centre`: the address by which it reaches the centre of the star."""

    name: str
    centre: str

    @property
    def prefix(self) -> tuple[str, ...]:
        """What a command line begins with that is to run there."""
        return ("ip", "netns", "exec", self.name)


def _ip(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)


@contextmanager
def star(size: int) -> Iterator[tuple[Host, Sequence[Host]]]:
    """A centre and `size` hosts, each with a link of its own to the centre, and no other.

    Skips the test where this is not permitted.
    """
    if shutil.which("ip") is None:
        pytest.skip("no network namespaces: the command `ip` is missing")
    centre = f"otc{os.getpid()}c"
    hosts = [Host(f"otc{os.getpid()}h{i}", f"10.77.{i}.1") for i in range(size)]
    made = []
    try:
        for name in (centre, *(host.name for host in hosts)):
            done = _ip("netns", "add", name)
            if done.returncode:
                pytest.skip(f"network namespaces are not permitted: {done.stderr.strip()}")
            made.append(name)
            assert _ip("-n", name, "link", "set", "lo", "up").returncode == 0
        for i, host in enumerate(hosts):
            pair = ("link", "add", f"to{i}", "type", "veth", "peer", "name", "up0")
            done = _ip("-n", centre, *pair, "netns", host.name)
            if done.returncode:
                pytest.skip(f"veth links are not permitted: {done.stderr.strip()}")
            for name, link, address in (
                (centre, f"to{i}", host.centre),
                (host.name, "up0", f"10.77.{i}.2"),
            ):
                for arguments in (
                    ("address", "add", f"{address}/24", "dev", link),
                    ("link", "set", link, "up"),
                ):
                    assert _ip("-n", name, *arguments).returncode == 0
        yield Host(centre, "127.0.0.1"), hosts
    finally:
        for name in made:
            _ip("netns", "delete", name)
