"""Going back to an earlier policy, with all data."""

from pathlib import Path

import pytest

from otc_dist.terminal.errors import UserError

from ..brains import ARMS, brain, online, pretrained, silent, transitions

OBSERVATIONS = transitions(7, 3).observations
EACH_ARM = pytest.mark.parametrize("arm", ["otc-value", "typical-conformal", "balanced"])


@EACH_ARM
def test_going_back_takes_an_earlier_policy_and_keeps_all_data(arm: str, tmp_path: Path) -> None:
    """After D_1 and D_2 on from pi_0: other than from pi_1, and the same whenever it is done."""
    learner = pretrained(*ARMS[arm], "deployment.count=3")
    learner.save(tmp_path / "pi_0")
    learner.tune(1, online(1), silent)
    learner.save(tmp_path / "pi_1")
    learner.tune(2, online(2), silent)
    forth = learner.policy_digest()

    digests = set()
    for again in range(2):
        back = brain(*ARMS[arm], "deployment.count=3")
        back.load(tmp_path / "pi_1")
        back.restore([online(1)])
        alpha = repr(back.alpha)  # its similarity may be NaN, which equals nothing
        back.revert(tmp_path / "pi_0")
        assert (back.tuned, repr(back.alpha)) == (1, alpha)
        fresh = pretrained(*ARMS[arm], "deployment.count=3")
        acts = (OBSERVATIONS, "evaluation", 0, 0)
        assert back.act(*acts).tobytes() == fresh.act(*acts).tobytes()
        back.tune(2, online(2), silent)
        digests.add(back.policy_digest())
        back.save(tmp_path / f"back_{again}")
    assert len(digests) == 1 and forth not in digests


def test_going_back_to_what_is_lost_or_of_another_is_refused(tmp_path: Path) -> None:
    learner = pretrained(*ARMS["uniform"])
    with pytest.raises(UserError, match="no checkpoint at"):
        learner.revert(tmp_path / "nothing")
    pretrained(*ARMS["uniform"], "seed=1").save(tmp_path / "other")
    before = learner.policy_digest()
    with pytest.raises(UserError, match="another description"):
        learner.revert(tmp_path / "other")
    assert learner.policy_digest() == before
