import math

import pytest

from otc_dist.terminal.amounts import duration, plus_minus


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [(0, "0 s"), (59.6, "1 min 00 s"), (65, "1 min 05 s"), (3725.4, "1 h 02 min")],
)
def test_durations(seconds: float, shown: str) -> None:
    assert duration(seconds) == shown


def test_a_mean_with_its_deviation() -> None:
    assert plus_minus(1234.5, 67.84) == "1,234.5 ± 67.8"
    assert plus_minus(0.5, 0.0625, digits=3) == "0.500 ± 0.062"
    assert plus_minus(1234.5, math.nan) == "1,234.5"
