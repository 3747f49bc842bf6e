"""Several seeds in one update: each learns what it learns alone, up to rounding."""

from pathlib import Path

import numpy as np
import pytest

from otc_dist.learner import checkpoint, together
from otc_dist.learner.learner import Learner
from otc_dist.learner.together import train_together
from otc_dist.learner.trainer import Progress
from otc_dist.steps.noise import to_arrays
from otc_dist.terminal.errors import UserError

from ..algorithms import every
from ..brains import silent, unsaved

SEEDS, UPDATES = (3, 0, 7), 30
# Beyond some tens of updates float32 diverges chaotically, however the updates are made.
ROUNDING = {"rtol": 1e-4, "atol": 2e-5}


def learners(name: str, *assignments: str, updates: int = UPDATES) -> list[Learner]:
    wanted = (f"offline.updates={updates}", *assignments)
    return [every.brain(name, f"seed={seed}", *wanted) for seed in SEEDS]


def assert_equal_up_to_rounding(alone: Learner, at_once: Learner) -> None:
    expected, found = (to_arrays(learner.policy[1]) for learner in (alone, at_once))
    assert expected.keys() == found.keys()
    for key, array in expected.items():
        assert found[key].dtype == array.dtype, key
        np.testing.assert_allclose(found[key], array, **ROUNDING, err_msg=key)


@every.EACH
def test_each_seed_learns_what_it_learns_alone(name: str) -> None:
    """And what comes after the updates, BREMEN's improvements and the fits, is each one's own."""
    at_once, reports = learners(name), list[Progress]()
    train_together(at_once, reports.append, unsaved)
    (told,) = reports
    assert (told.phase, told.update, told.updates) == ("offline", UPDATES, UPDATES)
    for learner, alone in zip(at_once, learners(name), strict=True):
        assert learner.offline[1].span == (UPDATES, UPDATES) and learner.tuned == -1
        own = list[Progress]()
        alone.pretrain(own.append, unsaved)
        for key, value in own[0].metrics.items():
            shared = told.metrics[f"seed {alone.description.seed}'s {key}"]
            assert shared == pytest.approx(value, rel=1e-4, abs=1e-5)
        learner.pretrain(silent, unsaved)
        assert_equal_up_to_rounding(alone, learner)
        assert learner.tuned == 0 and learner.together == SEEDS and not alone.together


def test_what_an_interruption_has_left_at_different_updates_is_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of three was saved after 100 updates; the others, after none yet."""
    monkeypatch.setattr(together, "SAVE_EVERY", 100)
    path, through = tmp_path / "unfinished", learners("td3bc", updates=110)

    def save() -> None:
        if not path.exists():
            through[1].save(path)

    train_together(through, silent, save)
    assert checkpoint.read(path)[1].together == SEEDS
    cut, told = learners("td3bc", updates=110), list[int]()
    cut[1].load(path)
    train_together(cut, lambda progress: told.append(progress.update), unsaved)
    assert told == [100, 110, 110]
    assert all(learner.offline[1].span == (110, 110) for learner in cut)
    assert cut[1].together == SEEDS[1:2] and cut[0].together == (SEEDS[0], SEEDS[2])


def test_a_seed_that_diverges_is_named() -> None:
    several = learners("td3bc", "algorithm.critic_learning_rate=1e30")
    with pytest.raises(UserError, match=r"diverged before update 30: seed 3's critic_loss is"):
        train_together(several, silent, unsaved)


def test_rows_that_each_seed_chooses_for_itself_are_refused() -> None:
    with pytest.raises(ValueError, match="one by one"):
        train_together(learners("td3bc", "offline.rows=typical"), silent, unsaved)
