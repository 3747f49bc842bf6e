"""Halves of a data set by whole episodes: what is fitted to one half can judge the other."""

from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from otc_dist.transitions import Float32, Transitions


def episodes(data: Transitions) -> NDArray[np.int64]:
    """The episode of each row (N,), numbered from 0 in the order of their first rows.

    A row goes on where the state is exactly the successor of an earlier row whose episode had not
    ended: so episodes are found in whatever order rows of several stand beside each other.
    """
    ended = (data.terminated | data.truncated).tolist()
    # Digests: of unordered data every row waits for a successor that never comes.
    going_on: dict[bytes, int] = {}
    found, count = np.empty(len(data), np.int64), 0
    rows = zip(data.observations, data.next_observations, ended, strict=True)
    for row, (state, successor, end) in enumerate(rows):
        number = going_on.pop(_digest(state), count)
        count = max(count, number + 1)
        found[row] = number
        if not end:
            going_on[_digest(successor)] = number
    return found


def _digest(state: Float32) -> bytes:
    return blake2b(state.tobytes(), digest_size=16).digest()


def folds(data: Transitions) -> NDArray[np.int64]:
    """0 or 1 (N,): every second episode; the halves of a single one."""
    number = episodes(data)
    if number.max(initial=0) == 0:
        return (np.arange(len(data)) >= len(data) // 2).astype(np.int64)
    return number % 2
