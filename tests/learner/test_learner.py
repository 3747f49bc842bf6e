"""The brain: the same bytes whatever happens on the way, from its own data alone."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from otc_dist.description.distances import DISTANCES
from otc_dist.learner import checkpoint
from otc_dist.learner.learner import Learner, Progress
from otc_dist.terminal.errors import UserError

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
EACH_ARM = pytest.mark.parametrize("arm", ARMS)


def test_training_that_diverges_is_one_line() -> None:
    learner = brain("algorithm.critic_learning_rate=1e30", "algorithm.actor_learning_rate=1e30")
    with pytest.raises(UserError, match=r"offline training diverged before update \d+: \w+ is nan"):
        learner.pretrain(silent, unsaved)


@EACH_ARM
def test_two_runs_give_the_same_bytes(arm: str, tmp_path: Path) -> None:
    first, second = (finished(brain(*ARMS[arm]), tmp_path / name) for name in "ab")
    assert first == second
    other = finished(brain(*ARMS[arm], "seed=1"), tmp_path / "c")
    assert first != other


@EACH_ARM
def test_resuming_offline_training_equals_no_interruption(arm: str, tmp_path: Path) -> None:
    learner, states = brain(*ARMS[arm]), []

    def save() -> None:
        states.append(tmp_path / f"offline_{len(states)}")
        learner.save(states[-1])

    learner.pretrain(silent, save)
    expected = finished(learner, tmp_path / "whole")
    assert len(states) == 2
    for state in states:
        resumed = brain(*ARMS[arm])
        resumed.load(state)
        assert resumed.tuned == -1
        assert finished(resumed, tmp_path / "resumed") == expected


@EACH_ARM
def test_resuming_after_a_deployment_equals_no_interruption(arm: str, tmp_path: Path) -> None:
    learner = pretrained(*ARMS[arm])
    learner.save(tmp_path / "0")
    learner.tune(1, online(1), silent)
    learner.save(tmp_path / "1")
    learner.tune(2, online(2), silent)
    learner.save(tmp_path / "2")
    expected = (tmp_path / "2").read_bytes()
    for k in (0, 1, 2):
        resumed = brain(*ARMS[arm])
        resumed.load(tmp_path / str(k))
        resumed.restore([online(j) for j in range(1, k + 1)])
        assert resumed.tuned == k
        assert finished(resumed, tmp_path / "resumed") == expected


def test_optimizer_state_and_targets_are_kept_across_deployments(tmp_path: Path) -> None:
    """Tuning twice is no pair of fresh starts: the update counter and the moments go on."""
    finished(brain(*ARMS["uniform"]), tmp_path / "end")
    arrays, progressed = checkpoint.read(tmp_path / "end")
    assert arrays["algorithm.updates"] == 25 + 2 * 6
    assert (progressed.tuned, progressed.offline_updates) == (2, 25)
    for name in ("vae", "critic", "actor"):
        assert np.abs(arrays[f"algorithm.{name}_moments"]).max() > 0
    for name in ("critic", "actor"):
        assert not np.array_equal(arrays[f"algorithm.{name}_target"], arrays[f"algorithm.{name}"])


def test_every_arm_tunes_the_same_offline_policy(tmp_path: Path) -> None:
    uniform = pretrained(*ARMS["uniform"])
    uniform.save(tmp_path / "shared")
    for arm, assignments in ARMS.items():
        own = pretrained(*assignments)
        assert own.policy_digest() == uniform.policy_digest(), arm
        taken = brain(*assignments)
        taken.load(tmp_path / "shared")
        compared = taken.description.sampling.compared
        fits = DISTANCES[compared].fits if compared else None
        assert taken.tuned == (-1 if fits else 0)  # what its distance fits is missing
        phases = []
        taken.pretrain(lambda progress, seen=phases: seen.append(progress.phase), unsaved)
        assert set(phases) == ({fits} if fits else set())
        assert finished(taken, tmp_path / "taken") == finished(own, tmp_path / "own"), arm


def test_an_embedding_that_is_not_needed_is_no_obstacle(tmp_path: Path) -> None:
    pretrained(*ARMS["otc-embedding"]).save(tmp_path / "shared")
    value = brain(*ARMS["otc-value"])
    value.load(tmp_path / "shared")
    assert value.tuned == 0
    expected = finished(brain(*ARMS["otc-value"]), tmp_path / "own")
    assert finished(value, tmp_path / "taken") == expected


def test_minibatch_key_changes_tuning_only() -> None:
    plain, other = pretrained(*ARMS["uniform"]), pretrained(*ARMS["uniform"], "minibatch_key=1")
    assert plain.policy_digest() == other.policy_digest()
    assert plain.description.offline_digest() == other.description.offline_digest()
    for learner in (plain, other):
        learner.tune(1, online(1), silent)
    assert plain.policy_digest() != other.policy_digest()


def test_minibatch_key_leaves_the_noise_alone() -> None:
    """With a single online transition every minibatch is the same; only noise could differ."""
    digests = set()
    for key in (0, 1):
        learner = pretrained(*ARMS["online-only"], f"minibatch_key={key}")
        learner.tune(1, transitions(3, 1), silent)
        digests.add(learner.policy_digest())
    assert len(digests) == 1


def test_deployments_are_tuned_on_in_order() -> None:
    learner = pretrained(*ARMS["uniform"])
    with pytest.raises(ValueError, match="cannot tune on deployment 2 after 0"):
        learner.tune(2, online(2), silent)
    learner.tune(1, online(1), silent)
    with pytest.raises(ValueError, match="cannot tune on deployment 1 after 1"):
        learner.tune(1, online(1), silent)


@pytest.mark.parametrize("arm", ["otc-embedding", "otc-value"])
def test_alpha_follows_the_expected_similarity(arm: str) -> None:
    learner = pretrained(*ARMS[arm], "sampling.alpha=0.8")
    measured = []
    for k in (1, 2):
        reports: list[Progress] = []
        learner.tune(k, transitions(50 * k, 40), reports.append)
        measured.append(reports[0].metrics)
        assert (reports[0].update, reports[0].updates, reports[0].deployment) == (0, 6, k)
        assert reports[-1].update == 6
        assert {"vae_loss", "critic_loss", "actor_loss", "guarded"} <= set(reports[-1].metrics)
        assert all(math.isfinite(x) for r in reports for x in r.metrics.values())
    first, second = measured
    assert first["alpha"] == 0.8
    assert second["similarity"] != first["similarity"]
    assert second["alpha"] == pytest.approx(0.8 * second["similarity"] / first["similarity"])
    assert learner.alpha.value == second["alpha"]


def test_alpha_matters_and_can_be_fixed() -> None:
    digests = set()
    for alpha in (0.0, 1.0):
        fixed = pretrained(*ARMS["otc-value"], f"sampling.alpha={alpha}", "sampling.adaptive=false")
        for k in (1, 2):
            fixed.tune(k, transitions(50 * k, 40), silent)
        assert fixed.alpha.value == alpha
        digests.add(fixed.policy_digest())
    assert len(digests) == 2


def test_a_binding_bound_of_alpha_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    learner = pretrained(*ARMS["otc-value"], "sampling.alpha=1.0", "sampling.alpha_bound=1e-9")
    learner.tune(1, online(1), silent)
    assert not caplog.records
    learner.tune(2, online(2), silent)
    assert learner.alpha.value == 1e-9
    assert "alpha_bound binds" in caplog.text


def test_reports_follow_training() -> None:
    reports: list[Progress] = []
    brain(*ARMS["otc-embedding"]).pretrain(reports.append, unsaved)
    seen = [(r.phase, r.update, r.updates) for r in reports]
    assert seen == [
        ("offline", 10, 25),
        ("offline", 20, 25),
        ("offline", 25, 25),
        ("embedding", 10, 10),
    ]
    assert 0 <= reports[-1].metrics["active_dimensions"] <= 4


@pytest.mark.parametrize("own", ["typical", "dynamics"])
def test_what_two_distances_share_is_fitted_once(own: str, tmp_path: Path) -> None:
    """For comparisons, whose arms start from one checkpoint: d_f and `typical` share their f_B."""
    reports: list[Progress] = []
    description = describe(f"sampling.distance={own}")
    learner = Learner(description, SPEC, transitions(0, 300), fits=("typical", "dynamics"))
    learner.pretrain(reports.append, unsaved)
    told = [r.update for r in reports if r.phase == "dynamics"]
    assert told and told == sorted(set(told))
    learner.save(tmp_path / "pi_0.safetensors")
    for distance in ("typical", "dynamics"):
        other = Learner(describe(f"sampling.distance={distance}"), SPEC, transitions(0, 300))
        other.load(tmp_path / "pi_0.safetensors")
        assert other.tuned == 0  # nothing is left to fit


def test_too_few_active_dimensions_are_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    pretrained(*ARMS["otc-embedding"], "embedding.minimum_active=5")
    assert "of 4 dimensions of the embedding are active" in caplog.text


def fail_to_load(learner: Learner, path: Path) -> str:
    with pytest.raises(UserError) as caught:
        learner.load(path)
    message = str(caught.value)
    assert "\n" not in message and str(path) in message
    return message


def test_checkpoints_of_others_are_refused(tmp_path: Path) -> None:
    learner = pretrained(*ARMS["uniform"])
    learner.save(tmp_path / "offline")
    learner.tune(1, online(1), silent)
    learner.save(tmp_path / "tuned")
    colleague = brain(*ARMS["uniform"], spec=replace(SPEC, name="agent_1"))
    assert "agent_0's, not agent_1's" in fail_to_load(colleague, tmp_path / "offline")
    for change in ("seed=1", "algorithm.discount=0.9", "offline.updates=26", "dataset.name=x"):
        stranger = brain(*ARMS["uniform"], change)
        assert "another description" in fail_to_load(stranger, tmp_path / "offline")
    for change in (*ARMS["otc-value"], "minibatch_key=1", "deployment.updates=7"):
        arm = brain(change if change in ARMS["otc-value"] else "sampling.name=uniform", change)
        arm.load(tmp_path / "offline")  # tuning differs, offline training does not
        assert "another description" in fail_to_load(arm, tmp_path / "tuned")


def test_missing_and_damaged_checkpoints_are_one_line(tmp_path: Path) -> None:
    assert "no checkpoint" in fail_to_load(brain(), tmp_path / "absent")
    (tmp_path / "empty").touch()
    assert "damaged" in fail_to_load(brain(), tmp_path / "empty")
    (tmp_path / "text").write_text("hello\n" * 100)
    assert "damaged" in fail_to_load(brain(), tmp_path / "text")
