"""A policy by itself acts as its learner does, and as the files do that it is exported to."""

import io
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch

from otc_dist import Policy, UserError
from otc_dist.description import user_code
from otc_dist.envs import registry
from otc_dist.learner import checkpoint, policy_export
from otc_dist.learner.actor import Actor
from otc_dist.learner.learner import Learner
from otc_dist.run.folder import RunFolder
from otc_dist.transitions import Float32

from ..algorithms.every import SECTIONS, pretrained

EACH = pytest.mark.parametrize("name", SECTIONS)


class Saved:
    """A run folder of one agent's offline policy, by an algorithm, and its learner."""

    def __init__(self, root: Path, name: str) -> None:
        env_id = "5m_vs_6m" if SECTIONS[name].discrete else "hopper-3x1"
        agent = registry.team_spec(env_id).agents[1]
        self.learner: Learner = pretrained(name, env=env_id, spec=agent)
        self.folder, self.spec = RunFolder(root), agent
        self.checkpoint = self.folder.checkpoint(agent.name, 0)
        self.learner.save(self.checkpoint)
        self.folder.description.write_text(self.learner.description.to_toml())

    def observations(self, copies: int) -> Float32:
        random, choices = np.random.default_rng(copies), self.spec.choices
        seen = random.standard_normal((copies, self.spec.observation_size)).astype(np.float32)
        if choices:
            seen[:, -choices:] = random.random((copies, choices)) < 0.5
            seen[np.arange(copies), -1 - random.integers(0, choices, copies)] = 1
        return seen

    def recommend(self, policy: object) -> None:
        self.folder.recommended(self.spec.name).write_text(json.dumps({"policy": policy}))


@pytest.fixture(scope="session")
def saved(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Saved]:
    return {name: Saved(tmp_path_factory.mktemp(name), name) for name in SECTIONS}


@pytest.fixture
def bcq(tmp_path: Path, saved: dict[str, Saved]) -> Saved:
    """A copy of the run, to be changed."""
    own = Saved.__new__(Saved)
    own.learner, own.spec = saved["bcq"].learner, saved["bcq"].spec
    own.folder = RunFolder(tmp_path / "run")
    own.checkpoint = own.folder.checkpoint(own.spec.name, 0)
    own.learner.save(own.checkpoint)
    own.folder.description.write_text(own.learner.description.to_toml())
    return own


@EACH
def test_it_acts_as_its_learner_does(saved: dict[str, Saved], name: str) -> None:
    run = saved[name]
    policy, seen = Policy.load(run.checkpoint), run.observations(5)
    assert (policy.digest, policy.spec) == (run.learner.policy_digest(), run.spec)
    assert repr(policy) == f"<Policy {policy.digest}: {name}, pi_0 of {run.spec.name}>"
    for step in (0, 3):
        actions = run.learner.act(seen, "evaluation", 0, step)
        assert policy.act(seen, step).tobytes() == actions.tobytes()
    acted = policy.act_as(seen, "deployment", 2, 1, exploring=True)
    assert acted.tobytes() == run.learner.act(seen, "deployment", 2, 1, exploring=True).tobytes()
    one = policy.act(seen[0].tolist())
    np.testing.assert_allclose(one, policy.act(seen)[0], rtol=0, atol=1e-6)
    assert one.shape == (run.spec.action_size,) and one.dtype == np.float32


@EACH
@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".onnx", ".pt2"])
def test_what_is_exported_acts_alike(
    saved: dict[str, Saved], tmp_path: Path, name: str, suffix: str
) -> None:
    """For any number of observations, with the numbers that `act` needs as inputs."""
    run, path = saved[name], tmp_path / f"policy{suffix}"
    spec = run.spec
    if not spec.choices:  # the environments here have bounds of -1 and 1: nothing to scale
        spec = replace(spec, action_low=(-0.1,), action_high=(0.3,))
    policy = Policy.of_checkpoint(run.checkpoint, run.learner.description, spec)
    policy.export(path)
    if suffix == ".onnx":
        session = onnxruntime.InferenceSession(path)
        told = json.loads(session.get_modelmeta().custom_metadata_map["otc_dist"])
    else:
        files = {"otc_dist.json": ""}
        module = torch.export.load(io.BytesIO(path.read_bytes()), extra_files=files).module()
        told = json.loads(files["otc_dist.json"])
    assert (told["agent"], told["digest"]) == (policy.spec.name, policy.digest)
    for copies, step in ((1, 0), (7, 5)):
        seen, noise = run.observations(copies), policy.noise(copies, step)
        assert {key: value["shape"][1:] for key, value in told["noise"].items()} == {
            key: list(array.shape[1:]) for key, array in noise.items()
        }
        if suffix == ".onnx":
            (actions,) = session.run(["actions"], {"observations": seen, **noise})
        else:
            actions = module(*map(torch.from_numpy, (seen, *noise.values()))).numpy()
        expected = policy.act(seen, step)
        assert actions.shape == expected.shape and actions.dtype == np.float32
        np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-5)


def test_noise_alone_makes_bcq_act_otherwise(saved: dict[str, Saved]) -> None:
    policy, seen = Policy.load(saved["bcq"].checkpoint), saved["bcq"].observations(3)
    assert not np.array_equal(policy.act(seen, 0), policy.act(seen, 1))
    first = policy.noise(1, 4)["act"]
    assert np.array_equal(first, policy.noise(3, 4)["act"][:1])


def test_which_policy_is_meant(bcq: Saved) -> None:
    run, agent = bcq.folder, bcq.spec.name
    assert Policy.load(run.root, agent=agent, deployment=0).deployment == 0
    with pytest.raises(UserError, match=r"not finished and recommends no policy.*there are 0\)"):
        Policy.load(run.root, agent=agent)
    bcq.recommend(0)
    assert Policy.load(str(run.root), agent=agent).digest == bcq.learner.policy_digest()
    bcq.recommend(1)
    with pytest.raises(UserError, match=r"no checkpoint at .*checkpoint_01"):
        Policy.load(run.root, agent=agent)


def _description(run: Saved, text: str) -> None:
    run.folder.description.write_text(text)


def _checkpoint(run: Saved, change: object = None, **progress: object) -> None:
    arrays, found = checkpoint.read(run.checkpoint)
    arrays = {key: change(key, array) for key, array in arrays.items()} if change else arrays  # type: ignore[operator]
    checkpoint.write(
        run.checkpoint, arrays, checkpoint.CheckpointMetadata(**{**vars(found), **progress})
    )


MISTAKES = {
    "is of agent_0, agent_1, agent_2: choose one with agent=": lambda run: run.recommend(0),
    "recommended.json is damaged: policy": lambda run: run.recommend("../x"),
    "is not a run folder: it has no description.toml": lambda run: run.folder.description.unlink(),
    "is not valid TOML": lambda run: _description(run, "["),
    "is damaged; delete it": None,
    "is of unfinished offline training": lambda run: _checkpoint(run, tuned=-1),
    "is agent_2's, not agent_1's": lambda run: _checkpoint(run, agent="agent_2"),
    "holds numbers that are not finite": lambda run: _checkpoint(
        run, lambda key, array: array * np.nan if key == "algorithm.critic" else array
    ),
    "holds no policy of bcq for agent_1": lambda run: _checkpoint(
        run, lambda key, array: array[:-1] if key == "algorithm.actor" else array
    ),
    "holds no policy of awac for agent_1": lambda run: _description(
        run,
        run.learner.description.with_assignments("algorithm={name='awac',hidden=[8,8]}").to_toml(),
    ),
    "needs too many random numbers": lambda run: _description(
        run,
        run.learner.description.with_assignments("algorithm.acting_candidates=9999999").to_toml(),
    ),
}


@pytest.mark.parametrize("message", MISTAKES)
def test_a_mistake_is_one_line(bcq: Saved, message: str) -> None:
    change = MISTAKES[message]
    if change is None:
        bcq.checkpoint.write_bytes(bcq.checkpoint.read_bytes()[:-1])
        message = "is damaged"
    else:
        change(bcq)
    several = message.startswith(("is of agent_0", "is not a run folder"))
    where = bcq.folder.root if several or "recommended" in message else bcq.checkpoint
    agent = bcq.spec.name if "recommended" in message else None
    with pytest.raises(UserError) as caught:
        Policy.load(where, agent=agent)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_other_mistakes_are_one_line(bcq: Saved, tmp_path: Path, monkeypatch) -> None:
    policy = Policy.load(bcq.checkpoint)
    alone = tmp_path / "alone.safetensors"
    alone.write_bytes(bcq.checkpoint.read_bytes())
    wrong = {
        "no run and no checkpoint at": lambda: Policy.load(tmp_path / "absent"),
        "is not in a run folder": lambda: Policy.load(alone),
        "unknown agent 'agent_9'": lambda: Policy.load(bcq.folder.root, agent="agent_9"),
        "is one checkpoint": lambda: Policy.load(bcq.checkpoint, deployment=0),
        "ends in .onnx or .pt2, not in '.pt'": lambda: policy.export(tmp_path / "policy.pt"),
        "cannot write": lambda: policy.export(alone / "policy.pt2"),
    }
    for message, call in wrong.items():
        with pytest.raises(UserError) as caught:
            call()
        assert message in str(caught.value) and "\n" not in str(caught.value)
    monkeypatch.setattr(policy_export, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"needs more packages: .*onnxscript"):
        policy.export(tmp_path / "policy.onnx")
    assert not (tmp_path / "policy.onnx").exists()
    for observations in (np.zeros((2, 3)), np.zeros((1, 1, 11)), np.full((1, 11), np.nan)):
        with pytest.raises(ValueError, match="agent_1"):
            policy.act(observations)


def test_a_policy_of_foreign_code_runs_none_of_it_unless_allowed(
    bcq: Saved, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(user_code, "_allowed", set())
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "foreign_env.py").write_text("raise RuntimeError('it ran')\n")
    text = bcq.folder.description.read_text().replace("hopper-3x1", "foreign_env:make")
    bcq.folder.description.write_text(text)
    with pytest.raises(UserError, match="allow='foreign_env:make'"):
        Policy.load(bcq.checkpoint)
    assert "foreign_env" not in sys.modules
    with pytest.raises(UserError, match="it ran"):
        Policy.load(bcq.checkpoint, allow="foreign_env:make")


def test_it_acts_on_one_thread_and_leaves_the_number_as_it_was(
    saved: dict[str, Saved], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As learners do: on several, large sums are split, and round otherwise."""
    policy, used, act = Policy.load(saved["bcq"].checkpoint), [], Actor.act

    def noted(self: Actor, *arguments: Any, **named: Any) -> Float32:
        used.append(torch.get_num_threads())
        return act(self, *arguments, **named)

    monkeypatch.setattr(Actor, "act", noted)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        policy.act(saved["bcq"].observations(3))
        assert (used, torch.get_num_threads()) == ([1], 2)
    finally:
        torch.set_num_threads(before)
