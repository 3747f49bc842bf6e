"""What an update is given, who tunes when, and what offline training looks at."""

from itertools import pairwise
from pathlib import Path

import pytest
import torch

from otc_dist.learner.learner import Learner

from ..brains import (
    ARMS,
    SPEC,
    brain,
    describe,
    finished,
    online,
    pretrained,
    silent,
    transitions,
    unsaved,
)

pytestmark = pytest.mark.usefixtures("small_blocks")


def test_what_imitates_sees_a_plain_sample() -> None:
    """Of the whole B_k, whatever the values see; with `all` both see the corrected batch."""
    for corrects, same in (("values", False), ("all", True)):
        learner = pretrained(
            *ARMS["otc-embedding"], f"sampling.corrects={corrects}", "sampling.alpha=20"
        )
        vae, critic = learner.policy[1]["vae"], learner.policy[1]["critic"]
        learner.tune(1, online(1), silent)
        plain = pretrained(*ARMS["otc-embedding"], f"sampling.corrects={corrects}")
        plain.tune(1, online(1), silent)
        # Another alpha changes which rows the values see; the imitation only where it sees them.
        assert torch.equal(learner.policy[1]["vae"], plain.policy[1]["vae"]) is not same
        assert not torch.equal(learner.policy[1]["critic"], plain.policy[1]["critic"])
        assert not torch.equal(learner.policy[1]["vae"], vae)
        assert not torch.equal(learner.policy[1]["critic"], critic)


def test_in_turns_one_agent_tunes_after_each_deployment() -> None:
    """By the deployment's number, without a message; the others merge what they saw."""
    moved: list[list[bool]] = []
    for index in range(3):
        description = describe(*ARMS["uniform"], "deployment.turns=true", "deployment.count=4")
        learner = Learner(description, SPEC, transitions(0, 200), place=(index, 3))
        learner.pretrain(silent, unsaved)
        digests = [learner.policy_digest()]
        for k in range(1, 5):
            learner.tune(k, online(k), silent)
            digests.append(learner.policy_digest())
        assert learner.tuned == 4 and learner._experience.extent.size == 200 + 4 * 40
        moved.append([now != before for before, now in pairwise(digests)])
    assert moved == [
        [True, False, False, True],
        [False, True, False, False],
        [False, False, True, False],
    ]


def test_offline_training_on_typical_rows_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    typical = ("offline.rows=typical", *ARMS["uniform"])
    whole = finished(brain(*typical), tmp_path / "whole")
    assert whole != finished(brain(*ARMS["uniform"]), tmp_path / "all")

    class StoppedError(Exception):
        pass

    def save() -> None:
        stopped.save(tmp_path / "unfinished")
        raise StoppedError

    stopped = brain(*typical)
    with pytest.raises(StoppedError):
        stopped.pretrain(silent, save)
    again = brain(*typical)
    again.load(tmp_path / "unfinished")
    assert finished(again, tmp_path / "again") == whole
