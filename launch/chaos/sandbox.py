"""Where runs are broken without harm to anybody else: namespaces of Linux, and a small disk."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_INSIDE = "OTC_DIST_CHAOS"  # set in the environment within
_ENTRIES = (
    ("unshare", "--user", "--map-root-user", "--net", "--mount"),
    ("unshare", "--net", "--mount"),
)
DISK_BYTES = 48 * 2**20
_TABLE = "inet otc_dist_chaos"
_CHAIN = f"{_TABLE} input"


@dataclass(frozen=True)
class Sandbox:
    """What can be broken here. Each is empty, or says why not.

    disk: a file system of DISK_BYTES, at `small`.
    net: a loopback interface of our own, and rules of nftables on it.
    """

    small: Path
    disk: str = ""
    net: str = ""

    def cut(self) -> None:
        """Every packet is lost from now on."""
        self._rule("drop")

    def drop_packets(self, percent: int) -> None:
        """So many packets are lost, at random, from now on."""
        self._rule(f"numgen random mod 100 < {percent} drop")

    def restore(self) -> None:
        """No packet is lost any more."""
        _nft(f"flush chain {_CHAIN}")

    def _rule(self, rule: str) -> None:
        self.restore()
        _nft(f"add rule {_CHAIN} {rule}")


def enter() -> None:
    """Start this program again inside namespaces of its own, if that is permitted."""
    if _INSIDE in os.environ:
        return
    for entry in _ENTRIES:
        if shutil.which(entry[0]) and not _fails(*entry, "true"):
            environment = {**os.environ, _INSIDE: "1"}
            command = [*entry, sys.executable, "-m", "otc_dist.launch", *sys.argv[1:]]
            os.execvpe(command[0], command, environment)


@contextmanager
def prepared(out: Path) -> Iterator[Sandbox]:
    """The sandbox, its small disk mounted in `out`."""
    small = out / "small-disk"
    if _INSIDE not in os.environ:
        why = "namespaces are not permitted here"
        yield Sandbox(small, why, why)
        return
    small.mkdir(exist_ok=True)
    disk = _fails("mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(small))
    net = _fails("ip", "link", "set", "lo", "up")
    if not net and shutil.which("nft") is None:
        net = "nft is not installed (Debian: nftables)"
    if not net:
        net = _fails("nft", f"add table {_TABLE}") or _fails(
            "nft", f"add chain {_CHAIN} {{ type filter hook input priority 0; }}"
        )
    try:
        yield Sandbox(small, disk, net)
    finally:
        if not disk:
            subprocess.run(["umount", "--lazy", str(small)], check=False)
            small.rmdir()


def _fails(*command: str) -> str:
    """Why a command fails, in a line; empty if it does not."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        return str(error)
    if done.returncode == 0:
        return ""
    lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
    return f"{command[0]}: {lines[0]}"


def _nft(command: str) -> None:
    subprocess.run(["nft", command], check=True)
