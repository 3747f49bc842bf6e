"""A Zenoh session, as this project uses one: explicit endpoints, bounded sizes, plain bytes.

The env host's session is the router of a star; learners and the launcher are its clients. Nothing
is discovered: multicast and gossip are off. Delivery is not relied on (see `lockstep`).
"""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

from otc_dist.bus.diagnosis import refusal
from otc_dist.bus.endpoints import Endpoint
from otc_dist.bus.links import configuration, zenoh
from otc_dist.terminal.errors import UserError

Put = Callable[[bytes], None]
Receive = Callable[[bytes], None]
Query = Callable[[Mapping[str, str]], bytes]

INBOX_SIZE = 256  # messages
WAKE_PERIOD = 0.05  # seconds
_ATTEMPT = 1.0  # seconds until it is asked why a link does not come about; then doubles, up to
_LONGEST_ATTEMPT = 4.0  # so that a refusal by a late listener is reported as soon


class Inbox:
    """What was published on a key, waiting for the thread that works; the newest 256 messages.

    Waiting happens inside Zenoh, without Python's lock, so that a message wakes one thread only.
    It has no timeout there; instead the session wakes all that wait, every `wake_period`, by an
    empty one of its own. So empty messages are no messages, from any sender.
    """

    def __init__(self, subscriber: Any, wake: Put) -> None:
        self._receive, self._look, self._wake = subscriber.recv, subscriber.try_recv, wake
        self._waiting = False

    def get(self, until: float) -> bytes | None:
        """The oldest message; None if none comes until about `until` (time.monotonic)."""
        self._waiting = True
        payload: bytes
        while not (payload := self._receive().payload.to_bytes()):
            if time.monotonic() >= until:
                break
        self._waiting = False
        return payload or None

    def look(self) -> bytes | None:
        """The oldest message that is there; None if there is none."""
        while (sample := self._look()) is not None:
            payload: bytes = sample.payload.to_bytes()
            if payload:
                return payload
        return None

    def wake(self) -> None:
        """Let a `get` that waits look at the time."""
        if self._waiting:
            self._wake(b"")


class Session:
    """Puts, receives, asks and answers bytes. Close it, or use it as a context manager.

    Receivers are called on Zenoh's only thread: they must be quick (put into a queue) and must
    not close or undeclare anything. Nor do they publish: `put` makes that thread hand over its work
    to another one, and a lock-step takes 1.35 times as long. Answering queries happens on a thread
    of its own.

    Attributes:
        wake_period: seconds by which `Inbox.get` may miss its deadline.
    """

    def __init__(self, session: Any) -> None:
        self._session = session
        self._declared: list[Any] = []
        self._publishers: list[Any] = []
        self._inboxes: list[Inbox] = []
        self._closing = threading.Event()
        self.wake_period = WAKE_PERIOD
        self._waker = threading.Thread(target=self._wake_inboxes, name="wake", daemon=True)

    @classmethod
    def listen(
        cls,
        endpoints: Sequence[Endpoint],
        maximum_payload: int,
        access: Mapping[str, object] | None = None,
    ) -> Self:
        """Open the star's centre. Its links are quick if no message is long: see `links`.

        Args:
            access: who may do what there (see `access`); None: any client may do everything.

        Raises:
            UserError: an endpoint is in use or cannot be listened on.
        """
        locators = [endpoint.locator for endpoint in endpoints]
        settings: dict[str, object] = {"listen/endpoints": locators}
        for endpoint in endpoints:
            settings |= endpoint.settings
        if access is not None:
            settings["access_control"] = access
        try:
            return cls(zenoh.open(configuration("router", maximum_payload, settings)))
        except zenoh.ZError as error:
            raise UserError(
                f"cannot listen on {' or '.join(locators)}: it is in use, not permitted or not an"
                f" endpoint ({_first_line(error)})"
            ) from None

    @classmethod
    def connect(cls, endpoint: Endpoint, maximum_payload: int, timeout: float = 30.0) -> Self:
        """Open a session of a learner or an observer; it reconnects by itself when cut off.

        Raises:
            UserError: nobody listens within `timeout` seconds; or, within a few seconds, the
                listener is refused or refuses.
        """
        end, attempt = time.monotonic() + timeout, _ATTEMPT
        while True:
            left = end - time.monotonic()
            settings: dict[str, object] = {
                "connect/endpoints": [endpoint.locator],
                "connect/timeout_ms": int(1000 * max(0.0, min(left, attempt))),
                "connect/exit_on_failure": True,
                "connect/retry": {
                    "period_init_ms": 50,
                    "period_max_ms": 500,
                    "period_increase_factor": 2,
                },
                **endpoint.settings,
            }
            try:
                return cls(zenoh.open(configuration("client", maximum_payload, settings)))
            except zenoh.ZError as error:
                if reason := refusal(endpoint):
                    raise UserError(reason) from None
                if left <= attempt:
                    raise UserError(
                        f"nobody listens on {endpoint.locator} after {timeout:.0f} s: does the env"
                        f" host run? ({_first_line(error)})"
                    ) from None
                attempt = min(2 * attempt, _LONGEST_ATTEMPT)

    def publisher(self, key: str) -> Put:
        """A function that publishes bytes on `key`; what the transport cannot take is dropped."""
        publisher = self._keep(
            self._session.declare_publisher(
                key, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.DATA
            )
        )
        self._publishers.append(publisher)
        put: Put = publisher.put
        return put

    @property
    def heard(self) -> bool:
        """Whether somebody subscribes to anything that this session publishes."""
        return any(publisher.matching_status.matching for publisher in self._publishers)

    def subscribe(self, key: str, receive: Receive) -> None:
        """Call `receive(payload)` for everything published on `key`."""

        def on_sample(sample: Any) -> None:
            receive(sample.payload.to_bytes())

        # Direct: not through another thread, which would cost a wake-up more.
        direct = zenoh.handlers.Callback(on_sample, indirect=False)
        self._keep(self._session.declare_subscriber(key, direct))

    def inbox(self, key: str) -> Inbox:
        """Everything published on `key`, for one thread to wait for."""
        channel = zenoh.handlers.RingChannel(INBOX_SIZE)
        subscriber = self._keep(self._session.declare_subscriber(key, channel))
        own = self._keep(
            self._session.declare_publisher(key, allowed_destination=zenoh.Locality.SESSION_LOCAL)
        )
        if not self._inboxes:
            self._waker.start()
        self._inboxes.append(Inbox(subscriber, own.put))
        return self._inboxes[-1]

    def _wake_inboxes(self) -> None:
        while not self._closing.wait(self.wake_period):
            for inbox in self._inboxes:
                inbox.wake()

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

    def ask_all(self, key: str, timeout: float) -> list[bytes]:
        """The answers of all who answer queries on `key`, within `timeout` seconds."""
        replies = self._session.get(
            key,
            timeout=timeout,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]

    def is_alive(self, key: str, timeout: float) -> bool:
        """Whether somebody's token `key` is there; one query of at most `timeout` seconds."""
        replies = self._session.liveliness().get(key, timeout=timeout)
        return any(reply.ok is not None for reply in replies)

    def declare_alive(self, key: str) -> None:
        """Let others see this process until it closes or dies."""
        self._keep(self._session.liveliness().declare_token(key))

    def watch_alive(self, key: str, on_change: Callable[[bool], None]) -> None:
        """Call `on_change(alive)` when the token `key` appears (also if it is there) or goes."""

        def on_sample(sample: Any) -> None:
            on_change(sample.kind == zenoh.SampleKind.PUT)

        direct = zenoh.handlers.Callback(on_sample, indirect=False)
        self._keep(self._session.liveliness().declare_subscriber(key, direct, history=True))

    @property
    def linked(self) -> bool:
        """Whether this client has a link to the star's centre now."""
        return bool(self._session.info.routers_zid())

    def _keep(self, declared: Any) -> Any:
        self._declared.append(declared)
        return declared

    def close(self) -> None:
        """Close; never waits longer than two seconds, whatever the state of the links."""
        self._closing.set()
        if self._waker.is_alive():
            self._waker.join()
        # zenoh#2675: closing may block for about 10 s when a link is lossy.
        closing = threading.Thread(target=self._session.close, name="closing", daemon=True)
        closing.start()
        closing.join(timeout=2.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _first_line(error: BaseException) -> str:
    """What Zenoh says, without the place in its sources."""
    return str(error).partition(" at /")[0].partition("\n")[0][:200]
