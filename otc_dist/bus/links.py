"""How Zenoh is set up: its threads, and its links to others.

A link is quick where all messages are short. On a quick link (Zenoh's low-latency transport) a
message is written by the thread that puts it; on an ordinary one, by a thread that must be woken
for it, and a lock-step takes a quarter longer. In return a quick link has no priorities, breaks by
a message beyond 64 KiB, and `put` waits when a frozen process has filled the socket's buffer.
"""

import json
import os
from collections.abc import Mapping
from typing import Any

# One thread per process for all of Zenoh's work. With its default of several, a step of the
# lock-step takes 1.4 times as long: every hand-over between threads costs a wake-up. Read by
# Zenoh when its first session opens.
os.environ.setdefault(
    "ZENOH_RUNTIME",
    "(app:(handover:rx),acc:(handover:rx),net:(handover:rx),tx:(handover:rx),rx:(worker_threads:1))",
)
import zenoh as _typed_zenoh

zenoh: Any = _typed_zenoh  # its stubs leave functions untyped; none of its types leave this file

# bytes; sessions that neither send nor take longer messages have quick links. So short that all
# that is asked of a frozen learner, until the lease ends its link, fits into the socket's buffer.
QUICK_PAYLOAD = 16_000
_ENVELOPE = 2**16  # bytes of a message beside its payload, at most: its key and what Zenoh adds
_LEASE_MS = 1500  # a frozen process is noticed soon after, and must be within 2 s


def configuration(mode: str, maximum_payload: int, settings: Mapping[str, object]) -> Any:
    """Zenoh's configuration of a session in `mode`, with other `settings` by their paths."""
    config = zenoh.Config()
    common: dict[str, object] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,  # milliseconds; a router otherwise waits 0.5 s to be discovered
        "timestamping/enabled": False,  # a router's default; nobody reads them
        "transport/shared_memory/enabled": False,
        # Where one side does not want a quick link, there is none: they agree on an ordinary one.
        "transport/unicast/lowlatency": maximum_payload <= QUICK_PAYLOAD,
        "transport/unicast/qos/enabled": maximum_payload > QUICK_PAYLOAD,
        # Batching stays on: without it, Zenoh 1.10 holds messages back for seconds.
        "transport/link/tx/lease": _LEASE_MS,
        "transport/unicast/max_sessions": 10_000,  # Zenoh stops at 1,000 by itself
        # What is put together of a message's fragments, before anything below can look at it.
        "transport/link/rx/max_message_size": maximum_payload + _ENVELOPE,
        "low_pass_filter": [
            {
                "id": "maximum_payload",
                "messages": ["put", "query", "reply"],
                "flows": ["ingress"],
                "key_exprs": ["**"],
                "size_limit": maximum_payload,
            }
        ],
    }
    for key, value in {**common, **settings}.items():
        config.insert_json5(key, json.dumps(value))
    return config
