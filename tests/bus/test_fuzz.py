"""Hostile and broken messages: `python -m tests.bus.fuzz` sends a million to each receiver."""

import pytest

from otc_dist.bus import handshake, history
from tests.bus import fuzz
from tests.bus.receivers import RECEIVERS

COUNT = 3000  # at each receiver
ENOUGH = 4 * 2**20  # bytes that a process's memory may seem to grow by chance


@pytest.mark.parametrize("receiver", RECEIVERS)
def test_what_is_not_expected_is_rejected_counted_and_forgotten(
    receiver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (handshake, history):
        monkeypatch.setattr(module, "_RETRY", 0.0)
    counts, grown = fuzz.run(receiver, COUNT, seed=0)
    assert sum(counts.values()) == COUNT
    assert all(count > 0 for count in counts.values())
    assert grown < ENOUGH
