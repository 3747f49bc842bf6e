"""Prioritized draws in two levels equal one running sum over all rows."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import stats

from otc_dist.otc.samplers.priorities import BLOCK, RESOLUTION, choose, fill, of, replace

Float32 = NDArray[np.float32]


def table(values: Float32) -> tuple[torch.Tensor, torch.Tensor]:
    return of(torch.from_numpy(values))


def on_grid(values: NDArray[np.float64]) -> Float32:
    return (np.round(values / RESOLUTION) * RESOLUTION).astype(np.float32)


def varied(random: np.random.Generator, count: int) -> Float32:
    """Six decades, with gaps of zeros, at both ends too."""
    values = on_grid(10 ** random.uniform(-3, 3, count))
    values[random.random(count) < 0.2] = 0
    values[[0, 1, -1]] = 0
    return values


def plain_choose(values: Float32, noise: Float32) -> NDArray[np.int64]:
    """One row from each of len(noise) equal parts of the running sum over all priorities."""
    running = np.cumsum(values, dtype=np.float64)
    points = (np.arange(len(noise)) + noise.astype(np.float64)) / len(noise) * running[-1]
    return np.array([np.argmax(running > point) for point in points])


@pytest.mark.parametrize("count", [5, BLOCK, 3 * BLOCK + 1, 5000])
def test_draws_equal_a_running_sum_over_all_rows(count: int) -> None:
    random = np.random.default_rng(count)
    for _ in range(20):
        values = varied(random, count)
        values[2] = 1  # never all 0
        noise = random.random(64, dtype=np.float32)
        chosen = choose(*table(values), torch.from_numpy(noise)).numpy()
        assert chosen.tolist() == plain_choose(values, noise).tolist()
        assert (values[chosen] > 0).all()


def test_the_ends_of_the_noise_draw_rows_that_have_a_priority() -> None:
    values = varied(np.random.default_rng(0), 700)
    for end in (np.float32(0), np.nextafter(np.float32(1), np.float32(0))):
        chosen = choose(*table(values), torch.full((128,), float(end)))
        assert (values[chosen.numpy()] > 0).all()


def test_draws_at_the_borders_of_blocks_skip_those_that_are_empty() -> None:
    values = np.repeat([0, 1, 0, 1, 0], BLOCK).astype(np.float32)
    chosen = choose(*table(values), torch.zeros(64)).numpy()  # every fourth of 256
    assert chosen.tolist() == [*range(BLOCK, 2 * BLOCK, 4), *range(3 * BLOCK, 4 * BLOCK, 4)]


def test_draws_are_proportional_to_the_priorities() -> None:
    random = np.random.default_rng(1)
    values = on_grid(random.uniform(0.5, 3, 300))
    noise = torch.from_numpy(random.random((3000, 32), dtype=np.float32))
    held = table(values)
    counts = np.bincount(
        np.concatenate([choose(*held, part).numpy() for part in noise]), minlength=300
    )
    expected = values.astype(np.float64) / values.sum(dtype=np.float64) * counts.sum()
    assert stats.chisquare(counts, expected).pvalue > 1e-3
    uniform = np.full(300, counts.sum() / 300)
    assert stats.chisquare(counts, uniform).pvalue < 1e-6  # the test can tell


def test_after_many_changes_the_sums_are_exact() -> None:
    random = np.random.default_rng(2)
    values = varied(random, 1000)
    held = table(values)
    for _ in range(50):
        rows = np.sort(random.integers(0, 1000, 40))
        new = random.uniform(1e-3, 1e3, 40).astype(np.float32)
        for row, value in reversed(list(zip(rows, new, strict=True))):  # the first of equals wins
            values[row] = on_grid(np.float64(value))
        held = replace(*held, torch.from_numpy(rows), torch.from_numpy(new))
    priorities, sums = held
    assert np.array_equal(priorities.view(-1)[:1000].numpy(), values)
    assert torch.equal(sums, priorities.double().sum(1))
    backwards = priorities.double().flip(1).cumsum(1)[:, -1]
    assert torch.equal(sums, backwards)  # in any order of addition


def test_filling_changes_these_rows_only() -> None:
    before, _ = table(varied(np.random.default_rng(3), 500))
    kept = before.clone()
    priorities, sums = fill(before, 100, 300, 2.5)
    assert torch.equal(before, kept)
    flat = priorities.view(-1)
    assert (flat[100:300] == 2.5).all()
    assert torch.equal(flat[:100], kept.view(-1)[:100])
    assert torch.equal(flat[300:], kept.view(-1)[300:])
    assert torch.equal(sums, priorities.double().sum(1))
