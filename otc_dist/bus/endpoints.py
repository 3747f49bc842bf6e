"""Where processes meet: a private socket on one machine, mutual TLS across hosts, or a refusal."""

import hashlib
import os
import re
import shutil
import stat
import tempfile
from dataclasses import dataclass
from pathlib import Path

from otc_dist.bus.addresses import HOST_FORM, is_host, is_ipv6
from otc_dist.bus.identity import Identity
from otc_dist.errors import UserError

SOCKET = "unixsock-stream/"
TLS = "tls/"
_LONGEST_SOCKET_PATH = 107  # bytes, of AF_UNIX, with room for Zenoh's suffix below


@dataclass(frozen=True)
class Door:
    """An endpoint to listen on or to connect to, and who one is there.

    Attributes:
        identity: for TLS; None elsewhere.
    """

    endpoint: str
    identity: Identity | None = None

    @property
    def settings(self) -> dict[str, object]:
        """Zenoh's settings for this door beside the endpoint itself."""
        return self.identity.settings() if self.identity else {}


def door(endpoint: str, process: str, certs: Path | None, insecure: bool) -> Door:
    """The door of `process` at `endpoint`.

    Raises:
        UserError: no endpoint, one without TLS though nobody said `--insecure`, or no certificate.
    """
    if not re.fullmatch(r"[a-z][a-z-]+/.+", endpoint):
        raise UserError(f"{endpoint!r} is no endpoint: write it as tls/192.0.2.1:7447")
    if insecure and certs is not None:
        raise UserError("--certs and --insecure contradict each other: leave out one")
    if endpoint.startswith(SOCKET):
        return Door(endpoint)
    rest = endpoint.partition("/")[2]
    if not re.search(r":\d+$", rest):
        raise UserError(f"{endpoint} has no port: write {endpoint}:7447")
    _check_host(rest.rpartition(":")[0], endpoint)
    if endpoint.startswith(TLS):
        if certs is None:
            raise UserError(
                f"{endpoint} needs --certs DIR, with certificates of python -m otc_dist.certs DIR"
            )
        return Door(endpoint, Identity.load(certs, process))
    if not insecure:
        raise UserError(
            f"{endpoint} is open to everybody who can reach it: use tls/{rest} with --certs DIR,"
            " or say --insecure"
        )
    return Door(endpoint)


def _check_host(host: str, endpoint: str) -> None:
    bare = host.removeprefix("[").removesuffix("]")
    if not is_host(bare) or is_ipv6(bare) != (host == f"[{bare}]"):
        raise UserError(
            f"the host in {endpoint!r} is not {HOST_FORM}: write it as tls/192.0.2.1:7447 or"
            " tls/[2001:db8::1]:7447"
        )


def local_endpoint(run: Path) -> str:
    """The endpoint of a run on one machine: a socket in a folder that only its user can enter.

    The folder lies under $XDG_RUNTIME_DIR or the temporary directory, since a socket's path must
    be short, and is named after a hash of the run folder's path. It is made if absent.

    Raises:
        UserError: the folder is somebody else's, or the path is too long.
    """
    digest = hashlib.sha256(str(run.resolve()).encode()).hexdigest()[:12]
    base = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    folder = base / f"otc-{os.getuid()}-{digest}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError as error:
        raise UserError(f"cannot make the bus's folder {folder}: {error.strerror}") from None
    private = stat.S_ISDIR(status.st_mode) and stat.S_IMODE(status.st_mode) == 0o700
    if not private or status.st_uid != os.getuid():
        raise UserError(f"{folder} must be a folder of yours with mode 0700; remove it, or mend it")
    socket = folder / "bus"
    if len(os.fsencode(socket)) > _LONGEST_SOCKET_PATH - len(".lock"):
        raise UserError(f"the socket path {socket} is too long; set a shorter TMPDIR")
    return f"{SOCKET}{socket}"


def remove_local_endpoint(endpoint: str) -> None:
    """Remove what `local_endpoint` made, once nobody listens; other endpoints are left alone."""
    folder = Path(endpoint.removeprefix(SOCKET)).parent
    if endpoint.startswith(SOCKET) and folder.name.startswith(f"otc-{os.getuid()}-"):
        shutil.rmtree(folder, ignore_errors=True)
