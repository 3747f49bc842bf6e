"""Deployments of devices that do not wait, at 50 Hz: real processes, a device late at random."""

import json
import re
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from otc_dist.deployment_log.arrays import read_log
from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.measuring import read_measured
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import read_header, read_steps, read_summary
from otc_dist.envs import registry
from otc_dist.replay.__main__ import main as replay
from otc_dist.replay.policies import Verdict, _check
from otc_dist.run.measured_returns import TooFewError
from otc_dist.spec import TeamSpec
from otc_dist.transitions import JointStep

from .. import carts
from .conftest import Services, step_bytes
from .wrapped import _stub

MakeRun = Callable[..., Services]
AGENTS = ("left", "right")
SET = (
    *(f"env.id={carts.ENV}", f"dataset.name={carts.ENV}/recorded", "env.copies=1"),
    *("evaluation.episodes=0", "deployment.rate_hz=50"),
)


@pytest.fixture(scope="module", autouse=True)
def robots() -> Iterator[None]:
    with carts.found():
        yield


def start(run: Services, **faults: Any) -> None:
    """Host and learners; `faults` are those of the agent `right`."""
    run.start("host", patient=True)
    run.start("left", stub=True)
    run.start("right", stub=True, **faults)


def told(path: Path) -> list[Any]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def happened(step: JointStep) -> bool:
    """Whether it is no step that closes an episode which was broken off."""
    return not (step.terminated & step.truncated).any()


@pytest.fixture(scope="module")
def played(
    make_run: MakeRun, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Services, list[Any]]:
    """Two deployments in which every fifth answer of `right` is late; what the carts were told."""
    root = tmp_path_factory.mktemp("real time")
    run = make_run(root / "run", *SET, "deployment.transitions=120", "deployment.keep=last")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CARTS_TOLD", str(root / "told"))
        start(run, late=[5, 0.03])
        assert set(run.wait_all().values()) == {0}, run.output("host") + run.output("right")
    return run, told(root / "told")


def logged(run: Services) -> list[JointStep]:
    return [step for k in (1, 2) for step in read_steps(run.folder.deployment(k))]


def test_the_log_has_what_was_executed_and_says_what_was_held(
    played: tuple[Services, list[Any]],
) -> None:
    run, commands = played
    steps = [step for step in logged(run) if happened(step)]
    executed = [[action.item() for action in step.actions] for step in steps]
    assert executed == [command for command in commands if command != "stop"]
    before = steps[0]
    for step in steps[1:]:
        for index, held in enumerate(step.held):
            if held:
                assert step.actions[index].tobytes() == before.actions[index].tobytes()
        before = step
    held = np.array([step.held for step in steps])
    assert held[:, 1].mean() > 0.1  # every fifth, but for the first of an episode
    assert np.mean([step.late for step in steps]) > 0.02  # a tenth, by half a period or more
    # The carts rest after each episode, before anything else is done.
    ends = [at for at, command in enumerate(commands) if command == "stop"]
    episodes = [read_summary(run.folder.deployment(k)).episodes for k in (1, 2)]
    assert len(ends) == sum(map(len, episodes)) and ends[-1] == len(commands) - 1


def test_the_rate_is_held_and_misses_are_counted(
    played: tuple[Services, list[Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    run, _ = played
    path = run.folder.deployment(1)
    log = read_log(path)
    assert read_header(path).timed and log.partial is None
    first, last = read_summary(path).times or (0, 0)
    assert (last - first) / 1e9 > 0.95 * 119 / 50  # never quicker than the rate
    assert replay([str(path)]) == 0
    said = capsys.readouterr().out
    counts = {name: int(log.held[name].sum()) for name in AGENTS}
    assert f"actions held: left {counts['left']}, right {counts['right']}" in said
    assert f"observations late: {int(log.late.sum())}; of 120 steps" in said


def test_learners_learn_from_what_was_executed(played: tuple[Services, list[Any]]) -> None:
    """Each one's next policy is made of the one before and of what the log has of it."""
    run, _ = played
    stub = _stub("true")
    for index, agent in enumerate(AGENTS):
        for k in (1, 2):
            learner = stub.Learner.__new__(stub.Learner)
            learner._spec, learner._expected = None, k - 1
            learner.load(run.folder.checkpoint(agent, k - 1))
            with OpenLog(run.folder.deployment(k)) as log:
                parts = [log.layout.transitions(rows, index) for rows in log.blocks()]
            learner.tune(k, parts[0].concatenate(parts), lambda _: None)
            found = json.loads(run.folder.checkpoint(agent, k).read_text())
            assert found == [k, learner._state.hex()]


class Acts:
    """A stub learner as `Policy`."""

    def __init__(self, run: Services, index: int, k: int) -> None:
        stub, (self.digest, self.spec) = _stub("true"), ("", run_team().agents[index])
        self._learner = stub.Learner.__new__(stub.Learner)
        self._learner._spec = self.spec
        self._learner.load(run.folder.checkpoint(self.spec.name, k - 1))

    def act_as(self, observations: Any, *moment: Any, exploring: bool) -> Any:
        return self._learner.act(observations, *moment, exploring=exploring)


def test_what_was_held_is_verified_as_such(played: tuple[Services, list[Any]]) -> None:
    """An action is its policy's, or else the one before, as the log says; not one or the other."""
    run, _ = played
    path = run.folder.deployment(1)
    summary, steps = read_summary(path), list(read_steps(path))
    first = next(step for step in steps if step.held[1])
    count = sum(step.held[1] for step in steps)

    def verdict(steps: list[JointStep]) -> Verdict:
        policy: Any = Acts(run, 1, 1)
        return _check(replace(summary, policies={}), policy, 1, steps)

    found = verdict(steps)
    assert found.holds and found.text.endswith(
        f"actions of {120 - count} steps computed again; in {count} the one before was held"
    )
    untold = [replace(step, held=(False, False)) for step in steps]
    assert verdict(untold).text.endswith(f"acts differently from the log in step {first.step}")
    other = (first.actions[0], -first.actions[1])
    changed = [replace(step, actions=other) if step is first else step for step in steps]
    assert "it holds another action than the one before" in verdict(changed).text


def run_team() -> TeamSpec:
    return registry.team_spec(carts.ENV)


def test_it_is_verified_and_nothing_moves_again(
    played: tuple[Services, list[Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    run, _ = played
    assert replay([str(run.folder.deployment(1)), "--verify"]) == 0
    said = capsys.readouterr().out
    assert "its episodes are not played again: they were played in real time" in said
    assert "ok    seeds of all episodes" in said


def test_whoever_stops_it_and_however_it_goes_on(
    make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed, stopped by a file, and by a signal; each time the same command goes on."""
    run = make_run(tmp_path / "run", *SET, "deployment.transitions=90", "deployment.count=1")
    record, path = tmp_path / "told", run.folder.deployment(1)
    monkeypatch.setenv("CARTS_TOLD", str(record))
    monkeypatch.setenv("CARTS_MARK", "15")
    for agent in AGENTS:
        run.start(agent, stub=True)

    def marked() -> list[list[bytes]]:
        """The log's steps, when 15 more have been told."""
        mark = Path(f"{record}.15")
        run.start("host", patient=True)
        run.wait_for_file(mark)
        mark.unlink()
        return [step_bytes(step) for step in read_steps(partial_path(path))]

    def go_on() -> list[JointStep]:
        """What is logged when it has been stopped; it began with what was there before."""
        steps = list(read_steps(partial_path(path)))
        assert [step_bytes(step) for step in steps][: len(before)] == before
        return steps

    before = marked()
    assert run.stop("host", signal.SIGKILL) == -signal.SIGKILL
    killed = go_on()
    assert all(map(happened, killed)) and told(record)[-1] != "stop"

    before = marked()
    run.folder.stop.touch()
    assert run.wait("host") == 3
    stopped = go_on()
    assert not run.folder.stop.exists()
    assert run.output("host").splitlines()[-1] == f"stopped: a person made {run.folder.stop}"
    closing = [step.step for step in stopped if not happened(step)]
    assert closing == [len(killed), len(stopped) - 1]
    assert told(record)[-1] == "stop"
    assert stopped[-1].held == (True, True) and not stopped[-1].rewards[0].any()

    before = marked()
    assert run.stop("host", signal.SIGTERM) == 128 + signal.SIGTERM
    ended = go_on()
    assert not happened(ended[-1]) and told(record)[-1] == "stop"

    run.start("host", patient=True)
    assert set(run.wait_all().values()) == {0}, run.output("host")
    with OpenLog(path) as log:
        assert log.extent.whole
    steps = list(read_steps(path))
    assert sum(not happened(step) for step in steps) == 3
    executed = [[action.item() for action in step.actions] for step in steps if happened(step)]
    commands = [command for command in told(record) if command != "stop"]
    assert [command for command in commands if command in executed] == executed
    assert len(commands) - len(executed) <= 1  # what was told and killed before it was logged
    assert len({step.episode_seeds.item() for step in steps}) == 4
    with pytest.raises(TooFewError):  # an interruption is no short episode of a bad policy
        read_measured(path)
    assert replay([str(path), "--verify"]) == 0


def test_a_learner_that_dies_costs_an_episode_and_nothing_else(
    make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slower = ("deployment.rate_hz=10", "deployment.transitions=40", "deployment.count=1")
    run = make_run(tmp_path / "run", *SET[:-1], *slower)
    monkeypatch.setenv("CARTS_TOLD", str(tmp_path / "told"))
    monkeypatch.setenv("CARTS_MARK", "15")
    monkeypatch.setenv("CARTS_PERIOD", "0.1")
    run.start("host")
    for agent in AGENTS:
        run.start(agent, stub=True)
    run.wait_for_file(tmp_path / "told.15")
    run.stop("left", signal.SIGKILL)
    run.wait_for_file(tmp_path / "told.stop")  # a learner may start sooner than 11 steps take
    run.start("left", stub=True)
    assert set(run.wait_all().values()) == {0}, run.output("host")
    assert "the episode is broken off, since 11 of " in run.output("host")
    steps = list(read_steps(run.folder.deployment(1)))
    closing = next(step.step for step in steps if not happened(step))
    assert steps[closing - 1].held[0]
    assert not any(steps[closing + 1].held) and len(steps) == 40


SLOW = {
    "answers": ({"late": [1, 0.05]}, "0.02", "answers too late: (left .+, )?right 1"),
    "observations": ({}, "0.05", "observations late: 1"),
}


@pytest.mark.parametrize("who", SLOW)
def test_a_rate_that_cannot_be_held_is_one_line_and_what_was_logged_stays(
    who: str, make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    faults, period, said = SLOW[who]
    run = make_run(tmp_path / "run", *SET, "deployment.transitions=600")
    monkeypatch.setenv("CARTS_TOLD", str(tmp_path / "told"))
    monkeypatch.setenv("CARTS_PERIOD", period)
    run.start("host")
    run.start("left", stub=True)
    run.start("right", stub=True, **faults)
    assert run.wait("host") == 2
    line = run.output("host").splitlines()[-1]
    assert line.startswith("error: deployment.rate_hz = 50 cannot be held: 11 of ")
    assert re.search(said, line) and "Traceback" not in run.output("host")
    steps = list(read_steps(partial_path(run.folder.deployment(1))))
    assert sum(not happened(step) for step in steps) == 3 and not happened(steps[-1])
    assert told(tmp_path / "told")[-1] == "stop"
    run.close()


def test_devices_are_reset_by_hand(
    make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = make_run(
        *(tmp_path / "run", *SET, "deployment.transitions=30", "deployment.count=1"),
        "deployment.reset_by_hand=true",
    )
    monkeypatch.setenv("CARTS_TOLD", str(tmp_path / "told"))
    folder = run.folder
    folder.reset_approval.parent.mkdir()
    folder.reset_approval.touch()  # of an earlier reset: it lets nothing begin
    start(run)
    run.wait_for_file(folder.waiting)
    assert not (tmp_path / "told").exists() and not folder.reset_approval.exists()
    waiting = json.loads(folder.waiting.read_text())
    assert waiting["waits_for"] == "a person to reset the devices, in deployment 1, step 0"
    (folder.root / waiting["approve_by"]).touch()
    assert set(run.wait_all().values()) == {0}, run.output("host")
    assert not folder.waiting.exists() and not folder.reset_approval.exists()
