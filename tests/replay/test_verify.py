"""`--verify` finds every bit that does not come out again, and nothing else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.header import versions
from otc_dist.deployment_log.reader import read_steps, read_summary
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs import registry
from otc_dist.learner import team
from otc_dist.learner.learner import Learner
from otc_dist.run.folder import RunFolder
from otc_dist.transitions import JointStep

from ..brains import transitions
from .deployments import FAMILIES, described, header_of, logged, played, retold

WRONG, CLOSE, UNBOUND = 1, 3, 4


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A deployment of every family of environments."""
    folder = tmp_path_factory.mktemp("families")
    return {env_id: played(folder / env_id / "log.mcap", env_id) for env_id in FAMILIES}


@pytest.mark.parametrize("env_id", FAMILIES)
def test_every_family_comes_out_again_to_the_bit(
    logs: dict[str, Path], replay, env_id: str
) -> None:
    status, output = replay(logs[env_id], "--verify")
    episodes = len(read_summary(logs[env_id]).episodes)
    assert status == 0, output
    assert f"{episodes} episodes played again, 120 steps: every observation, reward" in output
    assert "checksums of 120 steps, of" in output and "0 to 119 without a gap" in output
    assert "as many as its description asks for: 120" in output


def flipped(array: np.ndarray, copy: int) -> np.ndarray:
    """The lowest bit of one number of one copy."""
    out = array.copy()
    row = out[copy : copy + 1].view(np.uint8).reshape(-1)
    row[0] ^= 1
    return out


def exchanged(step: JointStep, field: str) -> JointStep:
    value = getattr(step, field)
    if isinstance(value, tuple):
        return replace(step, **{field: (flipped(value[0], 1), *value[1:])})
    return replace(step, **{field: flipped(value, 1)})


@pytest.mark.parametrize(
    ("field", "what"),
    [
        ("observations", "an observation"),
        ("rewards", "a reward"),
        ("next_observations", "a next observation"),
        ("truncated", "the episode's end"),
        ("state", "the simulator's state"),
    ],
)
@pytest.mark.parametrize("env_id", ["hopper-3x1", "predator-prey-3"])
def test_one_bit_is_found_and_named(
    logs: dict[str, Path], tmp_path: Path, replay, env_id: str, field: str, what: str
) -> None:
    steps = list(read_steps(logs[env_id]))
    ends = [step.step for step in steps if (step.terminated | step.truncated)[1]]
    number = ends[0] + 3
    wrong = retold(logs[env_id], tmp_path / "log.mcap", exchanged(steps[number], field))
    status, output = replay(wrong, "--verify")
    assert status == WRONG
    assert f"WRONG played again, step {number}, copy 1: {what} differs" in output


@pytest.mark.parametrize("after", [0, 60])  # steps that are left out before
def test_seeds_of_another_deployment_are_found_also_in_a_part(
    logs: dict[str, Path], tmp_path: Path, replay, after: int
) -> None:
    """The older form could hold them: what is logged there goes together."""
    wrong = retold(logs["navigation"], tmp_path / "log.mcap", deployment=1, format_version=1)
    status, output = replay(wrong, "--verify", "--steps", f"{after}:")
    assert status == WRONG
    assert (
        f"WRONG step {after}, copy 0: the episode's seed is not one that the run's seed" in output
    )
    assert f"{2 * (120 - after)} transitions of such episodes" in output
    assert "ok    seeds of all episodes" in replay(logs["navigation"], "--verify")[1]


def test_a_log_of_the_older_form_is_unbound_unless_that_is_accepted(
    logs: dict[str, Path], tmp_path: Path, replay
) -> None:
    path = retold(logs["navigation"], tmp_path / "log.mcap", format_version=1)
    status, output = replay(path, "--verify")
    assert status == UNBOUND
    assert "unbound log version 1: its checksums do not say" in output
    status, output = replay(path, "--verify", "--accept-unbound")
    assert status == 0 and "ok    unbound, as accepted" in output
    assert (
        "ok    every step is of run replayed-run, deployment 2"
        in (replay(logs["navigation"], "--verify")[1])
    )


def test_other_actions_are_found_where_they_first_matter(
    logs: dict[str, Path], tmp_path: Path, replay
) -> None:
    steps = list(read_steps(logs["hopper-3x1"]))
    step = steps[7]
    other = replace(step, actions=(step.actions[0] * np.float32(0.5), *step.actions[1:]))
    status, output = replay(retold(logs["hopper-3x1"], tmp_path / "log.mcap", other), "--verify")
    assert status == WRONG
    assert [line for line in output.splitlines() if "step 7, copy 0: a reward differs" in line]
    # Later episodes begin from their own seeds again: one difference per copy, not one per step.
    assert output.count("WRONG played again") == 2


def test_a_description_of_another_version_hides_no_simulation(
    logs: dict[str, Path], tmp_path: Path, replay
) -> None:
    text = described("navigation", 120, 2).to_toml() + '[new]\nkey = "value"\n'
    path = retold(logs["navigation"], tmp_path / "log.mcap", description=text)
    status, output = replay(path, "--verify")
    assert status == 0 and "120 steps: every observation" in output
    assert "-     its policies, since its description is not understood" in output
    assert "as many as its description asks for: 120" in output


def test_a_part_is_verified_from_its_first_state(logs: dict[str, Path], replay) -> None:
    status, output = replay(logs["hopper-3x1"], "--verify", "--steps", "37:61")
    assert status == 0 and "24 steps: every observation" in output


def test_another_mujoco_gives_one_step_errors(
    logs: dict[str, Path], tmp_path: Path, replay, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = {**versions(), "mujoco": "3.2.1"}
    path = retold(logs["hopper-3x1"], tmp_path / "log.mcap", versions=elsewhere)
    status, output = replay(path, "--verify")
    assert status == 0  # this one does the same
    assert "another simulator (mujoco 3.2.1 there, 4.0.0 here): 240 single steps" in output
    assert "rewards by 0 at most, 0 ends differ" in output

    from otc_dist.envs import robots

    load = robots.load_model

    def heavier(robot):
        model = load(robot)
        model.opt.gravity[2] *= 1.001
        return model

    monkeypatch.setattr(robots, "load_model", heavier)
    status, output = replay(path, "--verify")
    assert status == CLOSE
    line = next(line for line in output.splitlines() if "single steps" in line)
    assert line.startswith("  close another simulator") and "off by 0 standard" not in line
    assert replay(logs["hopper-3x1"], "--verify")[0] == WRONG  # that claims to be the same


def test_a_damaged_log_is_told(logs: dict[str, Path], tmp_path: Path, replay) -> None:
    data = bytearray(logs["navigation"].read_bytes())
    path = tmp_path / "log.mcap"
    data[len(data) // 4] ^= 1
    path.write_bytes(data)
    status, output = replay(path, "--verify")
    assert status == WRONG and "is damaged" in output and "--recover" in output


def test_bytes_that_no_step_depends_on_are_covered_too(
    logs: dict[str, Path], tmp_path: Path, replay
) -> None:
    data = bytearray(logs["navigation"].read_bytes())
    at = data.index(b"mcap-python")  # the library's name, in the header
    data[at] ^= 1
    path = tmp_path / "log.mcap"
    path.write_bytes(data)
    assert replay(path)[0] == 0
    status, output = replay(path, "--verify")
    assert status == WRONG and "crc validation failed" in output


def test_a_gap_is_told_and_what_is_behind_it_is_played(
    logs: dict[str, Path], tmp_path: Path, replay
) -> None:
    steps = list(read_steps(logs["hopper-3x1"]))
    writer = LogWriter.create(tmp_path / "log.mcap", header_of(described("hopper-3x1", 120, 2), 2))
    for step in steps:
        writer.write(step)
    writer.close()
    partial = partial_path(tmp_path / "log.mcap")
    data = bytearray(partial.read_bytes())
    data[-50 * (len(data) // 130)] ^= 1  # within some step
    partial.write_bytes(data)
    replay(partial, "--recover")
    status, output = replay(tmp_path / "log.recovered.mcap", "--verify")
    assert status == WRONG
    assert output.count("WRONG") == 2 and "are missing" in output
    assert "WRONG partial: 119 of 120 steps that its description asks for" in output
    assert "119 steps: every observation" in output


def test_an_unfinished_log_is_verified_as_far_as_it_goes(
    logs: dict[str, Path], tmp_path: Path, replay
) -> None:
    writer = LogWriter.create(tmp_path / "log.mcap", header_of(described("hopper-3x1", 120, 2), 2))
    for step in read_steps(logs["hopper-3x1"], 0, 30):
        writer.write(step)
    writer.close()
    status, output = replay(tmp_path / "log.mcap", "--verify")
    assert status == 0
    assert (
        "30 steps: every observation" in output and "unfinished: 30 of 120 steps that its" in output
    )


@pytest.fixture(scope="module")
def acted(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run folder with a deployment by brains whose checkpoints are there."""
    folder = RunFolder(tmp_path_factory.mktemp("acted"))
    description = described("hopper-3x1", 20, 2).with_assignments(
        "offline.updates=3", "algorithm.hidden=[8]", "deployment.exploration=sequential"
    )
    learners = []
    for agent in registry.team_spec("hopper-3x1").agents:
        learners.append(Learner(description, agent, transitions(0, 300, agent)))
        learners[-1].pretrain(lambda progress: None, lambda: None)
        learners[-1].save(folder.checkpoint(agent.name, 0))
    policies = {learner.spec.name: learner.policy_digest() for learner in learners}
    header, steps = header_of(description, 1), team.deploy(learners, 1)
    logged(folder.deployment(1), header, steps, policies)
    return folder


def test_logged_actions_are_those_of_the_checkpoints(acted: RunFolder, replay) -> None:
    status, output = replay(acted.deployment(1), "--verify")
    assert status == 0, output
    for agent, digest in read_summary(acted.deployment(1)).policies.items():
        assert f"ok    {agent}: policy {digest}, actions of 60 steps computed again" in output
    _, output = replay(acted.deployment(1), "--verify", "--agent", "agent_1")
    assert output.count("computed again") == 1


def test_an_action_that_the_policy_would_not_take_is_found(
    acted: RunFolder, tmp_path: Path, replay
) -> None:
    path = acted.deployment(1)
    run = RunFolder(tmp_path)
    for name in ("agent_0", "agent_1", "agent_2"):
        run.agent(name).mkdir(parents=True)
        run.checkpoint(name, 0).write_bytes(acted.checkpoint(name, 0).read_bytes())
    steps = list(read_steps(path))
    actions = (steps[9].actions[0], flipped(steps[9].actions[1], 0), steps[9].actions[2])
    steps[9] = replace(steps[9], actions=actions)
    summary = read_summary(path)
    logged(run.deployment(1), summary.header, steps, summary.policies)
    status, output = replay(run.deployment(1), "--verify")
    assert status == WRONG
    assert "WRONG agent_1: policy" in output and "differently from the log in step 9" in output
    assert output.count("computed again") == 2

    run.checkpoint("agent_0", 0).unlink()
    _, output = replay(run.deployment(1), "--verify")
    assert "-     agent_0: its checkpoint is not at" in output


def test_what_cannot_be_played_here_is_told_in_one_line(
    logs: dict[str, Path], tmp_path: Path, refused
) -> None:
    env_id = "smac/3m"
    spec = replace(registry.team_spec("navigation"), env_id=env_id)
    missing = retold(logs["navigation"], tmp_path / "a.mcap", team=spec)
    assert "cannot be played again here: smac/3m needs SMAC" in refused(missing, "--verify")
    unknown = retold(logs["navigation"], tmp_path / "b.mcap", team=replace(spec, env_id="chess"))
    assert "unknown environment 'chess'" in refused(unknown, "--verify")
    other = replace(registry.team_spec("navigation"), max_episode_steps=7)
    sizes = retold(logs["navigation"], tmp_path / "c.mcap", team=other)
    assert "another navigation" in refused(sizes, "--verify")
