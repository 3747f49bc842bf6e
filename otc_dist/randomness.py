"""Counter-based randomness: every draw is a function of its key alone.

A step or an update that is computed twice (after a crash, in another process layout, in a
test without a bus) draws the same numbers, so nothing of a generator's state is ever stored.
"""

import hashlib

import numpy as np


def _digest(key: tuple[int | str, ...], size: int) -> bytes:
    text = "\x1f".join(f"{type(part).__name__}:{part}" for part in key)
    return hashlib.blake2b(text.encode(), digest_size=size).digest()


def stream(seed: int, *key: int | str) -> np.random.Generator:
    """A generator that depends on (seed, *key) alone.

    The key names who draws, for what, and when, for example
    `stream(seed, "agent_0", "act", deployment, step)`.
    """
    words = np.frombuffer(_digest((seed, *key), 16), dtype="<u8").astype(np.uint64)
    return np.random.Generator(np.random.Philox(key=words))


def derive_seed(seed: int, *key: int | str) -> int:
    """A seed in [0, 2^63) that depends on (seed, *key) alone, for environments' own generators."""
    return int.from_bytes(_digest((seed, *key), 8), "little") >> 1
