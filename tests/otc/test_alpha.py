"""Adaptive alpha (Eq. 4)."""

import math

import pytest

from otc_dist.otc.alpha import Alpha


def after(*similarities: float, bound: float = 0.0) -> Alpha:
    alpha = Alpha(1.5)
    for similarity in similarities:
        alpha = alpha.adapt(similarity, bound)
    return alpha


def test_first_deployment_keeps_alpha_zero() -> None:
    assert after(7.0).value == 1.5


def test_it_telescopes() -> None:
    assert after(2.0, 3.0, 0.5, 8.0).value == pytest.approx(1.5 * 8.0 / 2.0, rel=1e-12)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_it_is_held_where_the_similarity_is_of_no_use(bad: float) -> None:
    assert after(2.0, 3.0, bad).value == after(2.0, 3.0).value
    assert after(bad).value == 1.5
    # and goes on from the last one that was
    assert after(2.0, 3.0, bad, 6.0).value == pytest.approx(1.5 * 6.0 / 2.0)
    assert after(bad, 2.0, 6.0).value == pytest.approx(1.5 * 6.0 / 2.0)


def test_a_bound_caps_it() -> None:
    assert after(1.0, 4.0, bound=3.0).value == 3.0
    assert after(1.0, 1.5, bound=3.0).value == pytest.approx(2.25)
    assert after(1.0, 4.0).value == 6.0
