"""A Zenoh session, as this project uses one: explicit endpoints, bounded sizes, plain bytes.

The env host's session is the router of a star; learners and the launcher are its clients. Nothing
is discovered: multicast and gossip are off. Delivery is not relied on (see `lockstep`).
"""

import hashlib
import json
import os
import shutil
import stat
import tempfile
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from otc_dist.errors import UserError

# One thread per process for all of Zenoh's work. With its default of several, a step of the
# lock-step takes 1.4 times as long: every hand-over between threads costs a wake-up. Read by
# Zenoh when its first session opens.
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(app:(handover:rx),acc:(handover:rx),net:(handover:rx),tx:(handover:rx),rx:(worker_threads:1))",
)
import zenoh as _typed_zenoh

zenoh: Any = _typed_zenoh  # its stubs leave functions untyped; none of its types leave this file

Put = Callable[[bytes], None]
Receive = Callable[[bytes], None]
Query = Callable[[Mapping[str, str]], bytes]

_LEASE_MS = 2000  # a frozen process is noticed within this time
_LONGEST_SOCKET_PATH = 107  # bytes, of AF_UNIX, with room for Zenoh's suffix below
_SCHEME = "unixsock-stream/"


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
    return f"{_SCHEME}{socket}"


def remove_local_endpoint(endpoint: str) -> None:
    """Remove what `local_endpoint` made, once nobody listens; other endpoints are left alone."""
    folder = Path(endpoint.removeprefix(_SCHEME)).parent
    if endpoint.startswith(_SCHEME) and folder.name.startswith(f"otc-{os.getuid()}-"):
        shutil.rmtree(folder, ignore_errors=True)


def _config(mode: str, maximum_payload: int, settings: Mapping[str, object]) -> Any:
    config = zenoh.Config()
    common: dict[str, object] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,  # milliseconds; a router otherwise waits 0.5 s to be discovered
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": _LEASE_MS,
        "low_pass_filter": [
            {
                "id": "maximum_payload",
                "messages": ["put", "delete", "query", "reply"],
                "flows": ["ingress", "egress"],
                "key_exprs": ["**"],
                "size_limit": maximum_payload,
            }
        ],
    }
    for key, value in {**common, **settings}.items():
        config.insert_json5(key, json.dumps(value))
    return config


class Session:
    """Puts, receives, asks and answers bytes. Close it, or use it as a context manager.

    Receivers are called on Zenoh's only thread: they must be quick (put into a queue) and must
    not close or undeclare anything. Answering queries happens on a thread of its own.
    """

    def __init__(self, session: Any) -> None:
        self._session = session
        self._declared: list[Any] = []

    @classmethod
    def listen(cls, endpoint: str, maximum_payload: int) -> Self:
        """Open the star's centre.

        Raises:
            UserError: the endpoint is in use or cannot be listened on.
        """
        settings = {"listen/endpoints": [endpoint]}
        try:
            return cls(zenoh.open(_config("router", maximum_payload, settings)))
        except zenoh.ZError as error:
            raise UserError(
                f"cannot listen on {endpoint}: it is in use, not permitted or no endpoint"
                f" ({_first_line(error)})"
            ) from None

    @classmethod
    def connect(cls, endpoint: str, maximum_payload: int, timeout: float = 30.0) -> Self:
        """Open a session of a learner or an observer; it reconnects by itself when cut off.

        Raises:
            UserError: nobody listens within `timeout` seconds.
        """
        settings: dict[str, object] = {
            "connect/endpoints": [endpoint],
            "connect/timeout_ms": int(timeout * 1000),
            "connect/exit_on_failure": True,
            "connect/retry": {
                "period_init_ms": 50,
                "period_max_ms": 500,
                "period_increase_factor": 2,
            },
        }
        try:
            return cls(zenoh.open(_config("client", maximum_payload, settings)))
        except zenoh.ZError as error:
            raise UserError(
                f"nobody listens on {endpoint} after {timeout:.0f} s: does the env host run?"
                f" ({_first_line(error)})"
            ) from None

    def publisher(self, key: str) -> Put:
        """A function that publishes bytes on `key`; what the transport cannot take is dropped."""
        publisher = self._keep(
            self._session.declare_publisher(
                key, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.DATA
            )
        )
        put: Put = publisher.put
        return put

    def subscribe(self, key: str, receive: Receive) -> None:
        """Call `receive(payload)` for everything published on `key`."""

        def on_sample(sample: Any) -> None:
            receive(sample.payload.to_bytes())

        # Direct: not through another thread, which would cost a wake-up more.
        direct = zenoh.handlers.Callback(on_sample, indirect=False)
        self._keep(self._session.declare_subscriber(key, direct))

    def answer(self, key: str, reply: Query) -> None:
        """Answer queries on `key` with `reply(parameters)`, or with the text of its LookupError."""

        def on_query(query: Any) -> None:
            with query:
                try:
                    query.reply(key, reply(dict(query.parameters)))
                except LookupError as error:
                    query.reply_err(str(error.args[0]).encode())

        self._keep(self._session.declare_queryable(key, on_query))

    def ask(self, key: str, parameters: Mapping[str, str], timeout: float) -> bytes | None:
        """The answer to a query; None if nobody answered within `timeout` seconds.

        Raises:
            LookupError: the other side refused, with its reason.
        """
        selector = key
        if parameters:
            selector += "?" + ";".join(f"{name}={value}" for name, value in parameters.items())
        for reply in self._session.get(selector, timeout=timeout):
            if reply.ok is not None:
                payload: bytes = reply.ok.payload.to_bytes()
                return payload
            text = reply.err.payload.to_bytes().decode(errors="replace")
            if text != "Timeout":
                raise LookupError(text)
        return None

    def declare_alive(self, key: str) -> None:
        """Let others see this process until it closes or dies."""
        self._keep(self._session.liveliness().declare_token(key))

    def watch_alive(self, key: str, on_change: Callable[[bool], None]) -> None:
        """Call `on_change(alive)` when the token `key` appears (also if it is there) or goes."""

        def on_sample(sample: Any) -> None:
            on_change(sample.kind == zenoh.SampleKind.PUT)

        direct = zenoh.handlers.Callback(on_sample, indirect=False)
        self._keep(self._session.liveliness().declare_subscriber(key, direct, history=True))

    def _keep(self, declared: Any) -> Any:
        self._declared.append(declared)
        return declared

    def close(self) -> None:
        """Close; never waits longer than two seconds, whatever the state of the links."""
        # zenoh#2675: closing may block for about 10 s when a link is lossy.
        closing = threading.Thread(target=self._session.close, daemon=True)
        closing.start()
        closing.join(timeout=2.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def _first_line(error: BaseException) -> str:
    """What Zenoh says, without the place in its sources."""
    return str(error).partition(" at /")[0].partition("\n")[0][:200]
