"""What a run keeps, refuses to keep, and asks a person, by the launcher."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.envs import registry
from otc_dist.launch.__main__ import main
from otc_dist.launch.plan import descriptions
from otc_dist.launch.run import resolve
from otc_dist.run.exploration import Schedule
from otc_dist.run.folder import RunFolder
from otc_dist.run.measured_returns import horizon
from otc_dist.terminal.errors import UserError

from .conftest import Launcher

Launch = Callable[..., Launcher]


def settled(*assignments: str, name: str = "3agent_hopper") -> str | None:
    chosen = descriptions.load(name, assignments, None, quick=True)
    return resolve.resolve(chosen).deployment.keep


@pytest.mark.parametrize(
    ("assignments", "kept"),
    [
        ((), "best"),
        (("deployment.keep=last",), "last"),
        (("deployment.exploration=sequential",), "last"),
        (("env.copies=1",), "last"),  # one episode may last until the end
        (("env.copies=1", "deployment.keep=best"), "best"),
        (("env.copies=1", "deployment.transitions=2000"), "best"),  # no episode lasts that long
    ],
)
def test_the_best_is_kept_where_that_is_sure_to_work(
    assignments: tuple[str, ...], kept: str
) -> None:
    assert settled(*assignments) == kept


@pytest.mark.parametrize("name", ["3agent_hopper", "2agent_halfcheetah", "2agent_walker2d"])
def test_a_deployment_of_the_robots_measures_whole_episodes(name: str) -> None:
    """What goes wrong late in an episode is measured, in as many copies as have room for it."""
    made = resolve.resolve(descriptions.load(name, ["engine.name=eager"], None, quick=False))
    team = registry.team_spec(made.env.id)
    longest = team.max_episode_steps
    steps = Schedule.of(made, len(team.agents)).steps
    assert horizon(steps, made.env.copies, longest) == longest
    assert made.deployment.transitions // (made.env.copies + 1) < longest  # one more has none


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("predator_prey", "best"),
        ("5m_vs_6m", "best"),
        ("1agent_hopper", "best"),
        ("navigation", "last"),  # whose deployments are of different dynamics
    ],
)
def test_tasks_with_one_reward_and_the_same_dynamics_keep_the_best(name: str, kept: str) -> None:
    assert settled("deployment.exploration=none", name=name) == kept


SHORT = ("env.copies=1", "deployment.transitions=1")


@pytest.mark.parametrize(
    ("assignments", "said"),
    [
        ((*SHORT, "deployment.keep=best"), "deployment.keep = 'best' needs 2 episodes"),
        ((*SHORT, "deployment.floor=1"), "deployment.floor needs 2 episodes"),
        (
            ("deployment.keep=best", "deployment.exploration=sequential"),
            "keep = 'best' needs exploration = 'none'",
        ),
        (
            ("deployment.floor=1", "deployment.exploration=sequential"),
            "floor needs exploration = 'none'",
        ),
        (("deployment.floor=low",), "deployment.floor: input should be a valid number"),
        (("deployment.floor=nan",), "deployment.floor: input should be a finite number"),
        (("deployment.keep=first",), "unknown deployment.keep 'first'; known: best, last"),
    ],
)
def test_what_cannot_be_kept_is_one_line_before_anything_runs(
    assignments: tuple[str, ...], said: str
) -> None:
    with pytest.raises(UserError) as refused:
        settled(*assignments)
    assert said in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("assignments", "said"),
    [
        (("deployment.exploration=sequential",), "revert needs exploration = 'none'"),
        (("env.copies=1",), "as a deployment may hold too few episodes"),
        (("deployment.keep=last",), "revert needs keep = 'best'"),
    ],
)
def test_where_a_description_goes_back_and_cannot_the_line_says_what_to_set(
    assignments: tuple[str, ...], said: str
) -> None:
    """Who changes something else may never have heard of deployment.revert."""
    with pytest.raises(UserError) as refused:
        settled(*assignments, name="2agent_walker2d")
    assert said in str(refused.value) and "\n" not in str(refused.value)
    assert "set deployment.revert=false" in str(refused.value)
    settled(*assignments, "deployment.revert=false", name="2agent_walker2d")


def dry(capsys: pytest.CaptureFixture[str], *assignments: str) -> str:
    flags = [part for assignment in assignments for part in ("--set", assignment)]
    assert main(["3agent_hopper", "--quick", "--dry-run", *flags]) == 0
    return capsys.readouterr().out


def test_a_dry_run_tells_what_is_kept_and_counts_the_confirmation(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    long = ("deployment.transitions=200000", "deployment.updates=1")  # where it shows
    plain, confirmed = dry(capsys, *long), dry(capsys, *long, "deployment.confirm=true")
    assert "the best deployed policy is recommended\n" in plain
    assert "one deployment more, of the last tuned policy" not in plain
    assert "one deployment more, of the last tuned policy" in confirmed

    def line(text: str, word: str) -> str:
        return next(line for line in text.splitlines() if line.startswith(word))

    for word in ("disk", "time"):
        assert line(plain, word) != line(confirmed, word)
    told = dry(capsys, "deployment.floor=2.5", "deployment.approve=true", "deployment.revert=true")
    for said in ("measures less than 2.5", "a person approves each", "tuning continues from it"):
        assert said in told


def test_nobody_is_waited_for_in_a_folder_of_no_run_or_of_one_that_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UserError, match="is not a run folder"):
        main(["approve", str(tmp_path)])


@pytest.mark.slow
def test_a_run_that_the_floor_ended_is_finished_and_says_so(
    launch: Launch, tmp_path: Path, tiny_flags: tuple[str, ...]
) -> None:
    launcher = launch("3agent_hopper", *tiny_flags, "--set", "deployment.floor=1e6")
    assert launcher.finish() == 0, launcher.text
    *_, ended, kept, _ = launcher.lines
    assert ended.startswith("no more deployments: deployment 1 measured")
    assert ended.endswith("below deployment.floor = 1,000,000")
    assert kept.startswith("recommended: the policy of deployment 1 (agents/*/checkpoint_00.")
    assert "made again" not in launcher.text
    folder = RunFolder(tmp_path / "runs" / "3agent_hopper-seed0")
    results = json.loads(folder.results.read_text())
    assert results["complete"] and results["deployments"] == 1
    assert results["stopped"]["deployment"] == 1 and len(results["evaluations"]) == 2


OWN = """
from pathlib import Path
import numpy as np
from gymnasium.spaces import Box
from pettingzoo import ParallelEnv

class Own(ParallelEnv):
    metadata = {"name": "own"}
    possible_agents, max_cycles = ["left", "right"], 10
    def observation_space(self, agent): return Box(-1, 1, (2,))
    def action_space(self, agent): return Box(-1, 1, (1,))
    def reset(self, seed=None, options=None):
        self.agents, self.count = list(self.possible_agents), 0
        return self.look(), {name: {} for name in self.agents}
    def look(self):
        return {name: np.float32([self.count / 10, 1]) for name in self.possible_agents}
    def step(self, actions):
        self.count += 1
        names, no = self.agents, dict.fromkeys(self.agents, False)
        cut = dict.fromkeys(names, self.count == 10)
        if self.count == 10:
            self.agents = []
        rewards = dict(zip(names, (1.0, 2.0 if Path('differ').exists() else 1.0)))
        return self.look(), rewards, no, cut, {name: {} for name in names}

def parallel_env(): return Own()
"""


@pytest.mark.slow
def test_rewards_that_differ_are_noticed_in_the_data_and_in_a_deployment(
    launch: Launch, tmp_path: Path, tiny_flags: tuple[str, ...]
) -> None:
    name = f"own_{tmp_path.name}"  # no test before this one has made its data
    flags = ("navigation", "--set", f"env.id={name}:parallel_env", "--set", "dataset.name=random")
    flags = (*flags, *tiny_flags, "--set", "sampling.name=uniform")
    flags = (*flags, "--set", "offline.updates=10", "--set", "deployment.count=1")
    best = (*flags, "--set", "deployment.keep=best")

    (tmp_path / f"{name}.py").write_text(OWN)
    alike = launch(*best, "--out", "alike")
    assert alike.finish() == 0, alike.text
    assert any(line.startswith("recommended: the policy of deployment 1") for line in alike.lines)

    (tmp_path / "differ").touch()
    refused = launch(*best, "--out", "deployed")  # its data are those of before
    assert refused.finish() == 2
    assert "error: host: deployment.keep = 'best' needs one reward for all agents" in refused.text
    assert "Traceback" not in refused.text

    kept = launch(*flags, "--out", "kept")  # it may give different rewards: the last is kept
    assert kept.finish() == 0, kept.text
    assert any(line.startswith("recommended: the last tuned policy") for line in kept.lines)

    other = launch(*best, "--set", "dataset.transitions=1204", "--out", "data")
    assert other.finish() == 2
    line = other.lines[-1]
    assert line.startswith(
        "error: deployment.keep = 'best' needs one reward for all agents, and in"
    )
    assert "left and right got different ones" in line
    assert not any("offline" in line for line in other.lines)


@pytest.mark.slow
def test_a_run_whose_deployments_a_person_approves(
    launch: Launch,
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = RunFolder(tmp_path / "run")
    asked = ("--set", "deployment.approve=true", "--set", "deployment.confirm=true")
    launcher = launch("3agent_hopper", *tiny_flags, *asked, "--out", "run")
    for k in (1, 2, 3):
        line = launcher.read_until(lambda line: line.startswith("waits for"))
        assert f"waits for a person's approval of deployment {k}, by policy {k - 1}" in line
        assert (f"deployment {k - 1} measured" in line) is (k > 1)
        said = launcher.read_until(lambda line: line.startswith("approve with: "))
        assert said == f"approve with: python -m otc_dist.launch approve {folder.root}"
        capsys.readouterr()
        assert main(["status", str(folder.root)]) == 0
        assert said in capsys.readouterr().out
        assert main(["status", str(folder.root), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["waiting"]["deployment"] == k
        assert main(["approve", str(folder.root)]) == 0
        assert f"approved: deployment {k}, by policy {k - 1}" in capsys.readouterr().out
    assert launcher.finish() == 0, launcher.text
    results = json.loads(folder.results.read_text())
    assert results["complete"] and results["deployments"] == 3
    kept = results["recommended"]
    assert launcher.lines[-2].startswith(
        f"recommended: the policy of deployment {kept['deployment']}"
        f" (agents/*/checkpoint_{kept['policy']:02d}.safetensors), measured"
    )
    for agent in ("agent_0", "agent_1", "agent_2"):
        told = json.loads(folder.recommended(agent).read_text())
        assert (told["deployment"], told["policy"]) == (kept["deployment"], kept["policy"])
    with pytest.raises(UserError, match="is not waiting for anyone now"):
        main(["approve", str(folder.root)])
