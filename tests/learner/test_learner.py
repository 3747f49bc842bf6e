"""The brain: the same bytes whatever happens on the way, from its own data alone."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from otc_dist.algorithms.bcq import Bcq
from otc_dist.datasets import store
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.writing import Provenance, locked, publish
from otc_dist.description import EmbeddingSection
from otc_dist.description.distances import DISTANCES
from otc_dist.envs import registry
from otc_dist.learner import checkpoint
from otc_dist.learner.learner import Learner, Progress
from otc_dist.spec import AgentSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Transitions

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

OBSERVATIONS = transitions(7, 3).observations


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


def test_acting_is_a_pure_function() -> None:
    learner = pretrained(*ARMS["uniform"])
    digest = learner.policy_digest()
    first = learner.act(OBSERVATIONS, "deployment", 1, 5)
    others = [
        learner.act(OBSERVATIONS, "deployment", 1, 6),
        learner.act(OBSERVATIONS, "deployment", 2, 5),
        learner.act(OBSERVATIONS, "evaluation", 1, 5),
    ]
    again = learner.act(OBSERVATIONS.copy(), "deployment", 1, 5)
    assert first.tobytes() == again.tobytes()
    assert first.shape == (3, 2) and first.dtype == np.float32
    assert learner.policy_digest() == digest
    for other in others:
        assert not np.array_equal(first, other)


def test_acting_does_not_disturb_tuning(tmp_path: Path) -> None:
    quiet, busy = pretrained(*ARMS["otc-value"]), pretrained(*ARMS["otc-value"])
    for step in range(3):
        busy.act(OBSERVATIONS, "deployment", 1, step)
    assert finished(quiet, tmp_path / "quiet") == finished(busy, tmp_path / "busy")


def test_agents_of_one_seed_draw_different_numbers() -> None:
    first = pretrained(*ARMS["uniform"])
    second = pretrained(*ARMS["uniform"], spec=replace(SPEC, name="agent_1"))
    assert first.policy_digest() != second.policy_digest()


def test_actions_are_scaled_to_asymmetric_bounds() -> None:
    """Behaviour that always does the same is imitated, in the environment's units."""
    data = transitions(0, 200)
    data.actions[:] = (0.22, -0.6)
    fast = ("algorithm.vae_learning_rate=0.01", "offline.updates=300", "algorithm.perturbation=0")
    learner = pretrained(*ARMS["uniform"], *fast, data=data)
    actions = learner.act(OBSERVATIONS, "deployment", 1, 0)
    error = np.abs(actions - [0.22, -0.6]) / (0.2, 2.0)  # of half the range
    assert error.max() < 0.1


@pytest.mark.parametrize("extreme", [-1.0, 1.0])
def test_actions_never_leave_the_bounds(extreme: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not by rounding either: in float32 the scaled 1 lies above 0.7, the scaled -1 below -0.7."""
    spec = replace(SPEC, action_low=(-0.1, -0.7), action_high=(0.7, 0.1))
    learner = brain(*ARMS["uniform"], spec=spec)
    monkeypatch.setattr(Bcq, "act", lambda *_: torch.full((3, 2), extreme))
    actions = learner.act(OBSERVATIONS, "deployment", 1, 0)
    expected = np.array(spec.action_low if extreme < 0 else spec.action_high, np.float32)
    assert (actions >= np.float32(spec.action_low)).all()
    assert (actions <= np.float32(spec.action_high)).all()
    np.testing.assert_allclose(actions, np.broadcast_to(expected, (3, 2)), rtol=1e-6)


@pytest.mark.parametrize("name", ["observations", "actions", "rewards", "next_observations"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_data_that_are_not_finite_are_refused(name: str, value: float) -> None:
    bad = transitions(0, 200)
    getattr(bad, name)[(17, *[0] * (getattr(bad, name).ndim - 1))] = value
    with pytest.raises(ValueError, match="not finite"):
        brain(data=bad)
    learner = pretrained(*ARMS["uniform"])
    before = learner.policy_digest()
    with pytest.raises(ValueError, match="not finite"):
        learner.tune(1, bad[:40], silent)
    assert (learner.tuned, learner.policy_digest()) == (0, before)
    learner.tune(1, online(1), silent)  # nothing of it was merged: there is room


def test_nobody_learns_from_a_step_that_did_not_happen() -> None:
    data, (first, second) = online(1), (pretrained(), pretrained())
    broken = np.isin(np.arange(len(data)), (0, 7, 8))
    both = {"terminated": data.terminated | broken, "truncated": data.truncated | broken}
    first.tune(1, replace(data, rewards=np.where(broken, 1e6, data.rewards), **both), silent)
    stands_in = np.arange(len(data))
    stands_in[[0, 7, 8]] = 1, 6, 6
    second.tune(1, data[stands_in], silent)
    assert first.policy_digest() == second.policy_digest()


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


def rewritten(folder: Path, level: str, change: Callable[[int, Transitions], Transitions]) -> str:
    """The name of a copy of a small random data set in which each agent's data are `change`d."""
    store.ensure("hopper-3x1/random", 400)
    joint = store.load_joint("hopper-3x1/random", 400)
    agents = [change(i, joint.of_agent(i)) for i in range(3)]
    changed = replace(
        joint,
        actions=tuple(agent.actions for agent in agents),
        rewards=tuple(agent.rewards for agent in agents),
    )
    name = DatasetName("hopper-3x1", level)
    with locked(name):
        publish(name, changed, Provenance("a test", {}, {}, np.zeros(1), 0))
    return str(name.folder.relative_to(name.folder.parents[1]))


def test_offline_policy_depends_on_the_agents_own_data_alone(tmp_path: Path) -> None:
    """Through the files: agent_2's data differ, agent_0's policy is the same to the bit."""

    def disturb(index: int, data: Transitions) -> Transitions:
        if index != 2:
            return data
        return replace(data, actions=-0.5 * data.actions, rewards=data.rewards + 1)

    names = [
        rewritten(tmp_path, "asis", lambda index, data: data),
        rewritten(tmp_path, "disturbed", disturb),
    ]
    team = registry.team_spec("hopper-3x1")
    digests: list[dict[str, str]] = []
    for name in names:
        digests.append({})
        for spec in team.agents:
            data = store.load_agent(store.agent_file(name, spec.name, 400), spec.name)
            digests[-1][spec.name] = pretrained(
                *ARMS["otc-embedding"], spec=spec, data=data
            ).policy_digest()
    asis, disturbed = digests
    assert disturbed["agent_0"] == asis["agent_0"]
    assert disturbed["agent_1"] == asis["agent_1"]
    assert disturbed["agent_2"] != asis["agent_2"]


def test_data_of_another_size_are_refused() -> None:
    narrow = AgentSpec("agent_0", 5, (-1.0,), (1.0,))
    with pytest.raises(ValueError):
        brain(data=transitions(0, 200, narrow))
    shallow = AgentSpec("agent_0", 1, SPEC.action_low, SPEC.action_high)
    with pytest.raises(ValueError, match="sizes"):  # numpy would stretch it
        brain(data=transitions(0, 200, shallow))


@pytest.mark.slow
@pytest.mark.parametrize("env", ["hopper-3x1", "walker2d-2x3"])
def test_embedding_of_real_data_keeps_more_than_three_dimensions(env: str) -> None:
    """With the shipped weight of KL; a third of the shipped updates, few transitions."""
    name = f"{env}/medium-replay"
    store.ensure(name, 20_000)
    spec = registry.team_spec(env).agents[0]
    data = store.load_agent(store.agent_file(name, spec.name, 20_000), spec.name)
    small = describe(*ARMS["otc-embedding"], "offline.updates=0")
    usual = small.model_copy(update={"embedding": EmbeddingSection(updates=3000)})
    reports: list[Progress] = []
    Learner(usual, spec, data).pretrain(reports.append, unsaved)
    assert reports[-1].metrics["active_dimensions"] > 3
    assert reports[-1].metrics["embedding_loss"] < 0.1  # and it reconstructs actions
