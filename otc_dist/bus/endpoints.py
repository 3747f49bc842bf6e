"""Where processes meet: a private socket on one machine, mutual TLS across hosts, or a refusal."""

import hashlib
import os
import re
import shutil
import socket
import stat
import tempfile
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from otc_dist.bus.addresses import HOST_FORM, is_host, is_ipv6
from otc_dist.bus.identity import Identity
from otc_dist.system import locks
from otc_dist.terminal.errors import UserError

SOCKET = "unixsock-stream/"
TLS = "tls/"
_LONGEST_SOCKET_PATH = 107  # bytes, of AF_UNIX, with room for Zenoh's suffix below
_MEMORY = "/dev/shm"  # Linux's own file system has sockets and locks, whatever the others are
_FOLDER, _NAME = ".bus", "bus"  # in a run's folder; the socket in that


@dataclass(frozen=True)
class Endpoint:
    """Where to listen or to connect to, and as whom.

    Attributes:
        locator: as Zenoh writes it: tls/192.0.2.1:7447.
        identity: for TLS; None elsewhere.
    """

    locator: str
    identity: Identity | None = None

    @property
    def settings(self) -> dict[str, object]:
        """Zenoh's settings for this endpoint beside its locator."""
        return self.identity.settings() if self.identity else {}


def parse_endpoint(locator: str, process: str, certs: Path | None, insecure: bool) -> Endpoint:
    """The endpoint of `process` at `locator`, with its certificate.

    Raises:
        UserError: no locator, one without TLS though nobody said `--insecure`, or no certificate.
    """
    if not re.fullmatch(r"[a-z][a-z-]+/.+", locator):
        raise UserError(f"{locator!r} is not a valid endpoint: write it as tls/192.0.2.1:7447")
    if insecure and certs is not None:
        raise UserError("--certs and --insecure contradict each other: leave out one")
    if locator.startswith(SOCKET):
        return Endpoint(locator)
    rest = locator.partition("/")[2]
    if not re.search(r":\d+$", rest):
        raise UserError(f"{locator} has no port: write {locator}:7447")
    _check_host(rest.rpartition(":")[0], locator)
    if locator.startswith(TLS):
        if certs is None:
            raise UserError(
                f"{locator} needs --certs DIR, with certificates of python -m otc_dist.certs DIR"
            )
        return Endpoint(locator, Identity.load(certs, process))
    if not insecure:
        raise UserError(
            f"{locator} is open to everybody who can reach it: use tls/{rest} with --certs DIR,"
            " or use --insecure"
        )
    return Endpoint(locator)


def _check_host(host: str, endpoint: str) -> None:
    bare = host.removeprefix("[").removesuffix("]")
    if not is_host(bare) or is_ipv6(bare) != (host == f"[{bare}]"):
        raise UserError(
            f"the host in {endpoint!r} is not {HOST_FORM}: write it as tls/192.0.2.1:7447 or"
            " tls/[2001:db8::1]:7447"
        )


def local_endpoint(run: Path) -> str:
    """The endpoint of a run on one machine: a socket in a folder that only its user can enter.

    The folder lies in the run's own, which is there as long as the run is; or, where its path is
    too long for a socket or its file system has none, or no locks, in the temporary one or that of
    the memory, named after a hash of the run folder's path. It is made if absent; all processes of
    a run on a machine find the same.

    Raises:
        UserError: somebody else has made the folder, or there is no place for one.
    """
    digest = hashlib.sha256(str(run.resolve()).encode()).hexdigest()[:12]
    temporary = dict.fromkeys(map(Path, (tempfile.gettempdir(), "/tmp", _MEMORY)))
    reasons = []
    for folder in (run.resolve() / _FOLDER, *(t / f"{_prefix()}{digest}" for t in temporary)):
        reason = _unfit(folder)
        if not reason:
            return f"{SOCKET}{folder / _NAME}"
        reasons.append(f"{folder}: {reason}")
    raise UserError(
        "no folder for the bus's socket: set TMPDIR to one of yours with a short path, on a file"
        f" system with sockets and locks ({'; '.join(reasons)})"
    )


def _prefix() -> str:
    return f"otc-{os.getuid()}-"


def _unfit(folder: Path) -> str:
    """Make a folder for the bus's socket; why that cannot lie there, or nothing.

    Raises:
        UserError: others may enter the folder, or it is somebody else's.
    """
    if len(os.fsencode(folder / _NAME)) > _LONGEST_SOCKET_PATH - len(".lock"):
        return "its path is too long"
    try:
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700)
            folder.chmod(0o700)  # whatever the umask
        status = folder.lstat()
        theirs = status.st_uid != os.getuid()
        if theirs and folder.name == _FOLDER:  # a reader of another's run has a bus of its own
            return "it is somebody else's"
        # Bits beyond these may be inherited, as the setgid bit is.
        if (
            theirs
            or not stat.S_ISDIR(status.st_mode)
            or stat.S_IMODE(status.st_mode) & 0o777 != 0o700
        ):
            raise UserError(
                f"{folder} must be a folder of yours with mode 0700; remove it, or set TMPDIR to a"
                " folder that only you can enter"
            )
        with socket.socket(socket.AF_UNIX) as probe:
            path = folder / f"{threading.get_native_id()}"
            probe.bind(str(path))
            path.unlink()
        with path.open("wb") as file:  # a listener holds a lock on a file beside the socket
            locked = locks.held(file.fileno()) is not None
        path.unlink()
        if not locked:
            with suppress(OSError):
                folder.rmdir()
            return "its file system has no locks"
    except OSError as error:
        return os.strerror(error.errno) if error.errno else str(error)
    return ""


def local_socket(endpoint: str) -> Path | None:
    """The file of an endpoint that `local_endpoint` gave; None of others."""
    path = Path(endpoint.removeprefix(SOCKET))
    ours = path.parent.name == _FOLDER or path.parent.name.startswith(_prefix())
    return path if endpoint.startswith(SOCKET) and path.name == _NAME and ours else None


def remove_local_endpoint(endpoint: str) -> None:
    """Remove what `local_endpoint` made, once nobody listens; other endpoints are left alone."""
    if (path := local_socket(endpoint)) is not None:
        shutil.rmtree(path.parent, ignore_errors=True)
