"""Counter-based randomness: the key is all that matters."""

import numpy as np

from otc_dist.randomness import derive_seed, stream

KEYS = [
    (0,),
    (1,),
    (0, "agent_0"),
    (0, "agent_1"),
    (0, "agent_0", 1),
    (0, "agent_0", "1"),
    (0, "agent_0", 1, 2),
    (0, "agent_0", 12),
    (0, "agent_01", 2),
    (0, "agent_0", "act", 1, 2),
    (0, "agent_0", "act", 2, 1),
]


def test_a_key_gives_the_same_numbers_whatever_was_drawn_before() -> None:
    first = stream(3, "agent_0", "act", 1, 2).standard_normal(100)
    stream(3, "agent_0", "act", 1, 3).standard_normal(7)
    np.random.seed(0)
    assert np.array_equal(stream(3, "agent_0", "act", 1, 2).standard_normal(100), first)


def test_the_numbers_are_those_of_other_machines_and_versions() -> None:
    """Stored runs depend on them: a change here breaks every resumed run."""
    assert stream(0, "agent_0", "act", 1).integers(0, 1000, 4).tolist() == [337, 854, 567, 24]
    assert derive_seed(0, "episode", 3) == 5305361850038745233


def test_different_keys_give_different_numbers() -> None:
    draws = {tuple(stream(*key).integers(0, 2**62, 4)) for key in KEYS}
    seeds = {derive_seed(*key) for key in KEYS}
    assert len(draws) == len(seeds) == len(KEYS)
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_streams_of_neighbouring_keys_are_independent() -> None:
    rows = np.array([stream(0, "x", block).standard_normal(2000) for block in range(20)])
    correlations = np.corrcoef(rows)[~np.eye(20, dtype=bool)]
    assert np.abs(correlations).max() < 5 / np.sqrt(2000)
    assert abs(rows.mean()) < 4 / np.sqrt(rows.size)
