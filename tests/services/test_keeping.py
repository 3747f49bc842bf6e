"""Which policy a run recommends and goes on from, and when it waits or ends: real processes."""

import json
import os
import select
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from otc_dist.deployment_log.measuring import read_measured
from otc_dist.run import measured_returns

from .conftest import AGENTS, PROCESSES, Services

MakeRun = Callable[..., Services]
LAST = 80 // 4  # the question that carries a deployment's last outcome
BEST = ("deployment.keep=best", "deployment.count=4")


def finish(run: Services) -> None:
    assert set(run.wait_all().values()) == {0}, run.output("host") + run.output("agent_0")


def undisturbed(make_run: MakeRun, root: Path, *assignments: str) -> Services:
    run = make_run(root, *assignments)
    run.start_all(stub=True)
    finish(run)
    return run


@pytest.fixture(scope="module")
def confirmed(make_run: MakeRun, tmp_path_factory: pytest.TempPathFactory) -> Services:
    """Four deployments, and one more that confirms."""
    root = tmp_path_factory.mktemp("confirmed") / "run"
    return undisturbed(make_run, root, *BEST, "deployment.confirm=true")


@pytest.fixture(scope="module")
def reverting(make_run: MakeRun, tmp_path_factory: pytest.TempPathFactory) -> Services:
    """Four deployments, each tuned from the best policy before it."""
    root = tmp_path_factory.mktemp("reverting") / "run"
    return undisturbed(make_run, root, *BEST, "deployment.revert=true")


def recommendations(run: Services) -> list[dict[str, Any]]:
    return [json.loads(run.folder.recommended(agent).read_text()) for agent in AGENTS]


def by_the_logs(run: Services, deployments: int) -> list[measured_returns.Measured]:
    return [read_measured(run.folder.deployment(k))[1] for k in range(1, deployments + 1)]


def test_all_learners_recommend_what_the_logs_say_was_best(confirmed: Services) -> None:
    found = by_the_logs(confirmed, 5)
    assert len({one.mean for one in found}) == 5
    best = measured_returns.best(found)
    for agent, content in zip(AGENTS, recommendations(confirmed), strict=True):
        assert content == {
            "agent": agent,
            "deployment": best,
            "policy": best - 1,
            "checkpoint": f"checkpoint_{best - 1:02d}.safetensors",
            "keep": "best",
        }
    assert f"deployment 5 measured {found[4].mean:.1f}" in confirmed.output("host")


def test_the_last_tuned_policy_is_deployed_once_more_and_not_tuned_on(confirmed: Services) -> None:
    assert confirmed.folder.deployment(5).exists() and not confirmed.folder.deployment(6).exists()
    assert not confirmed.folder.evaluation(5).exists()
    assert not confirmed.folder.checkpoint("agent_0", 5).exists()


@pytest.mark.parametrize(
    "moment",
    [
        ["deployment", 3, 7],
        pytest.param(["deployment", 5, 3], marks=pytest.mark.slow),
        pytest.param(["deployment", 5, LAST], marks=pytest.mark.slow),
        ["done", 5, 0],
    ],
)
def test_a_delayed_and_a_restarted_learner_decide_as_the_others(
    make_run: MakeRun, confirmed: Services, tmp_path: Path, moment: list[object]
) -> None:
    run = make_run(tmp_path / "run", *BEST, "deployment.confirm=true")
    run.start("host")
    run.start("agent_0", stub=True, delay=0.005)
    run.start("agent_1", stub=True, kill=moment)
    run.start("agent_2", stub=True)
    assert run.wait("agent_1") == -signal.SIGKILL
    run.start("agent_1", stub=True)
    finish(run)
    decisions = [(content["deployment"], content["checkpoint"]) for content in recommendations(run)]
    assert len(set(decisions)) == 1
    assert run.result() == confirmed.result()


def test_the_last_tuned_policy_is_recommended_where_that_is_asked_for(
    make_run: MakeRun, tmp_path: Path
) -> None:
    run = undisturbed(make_run, tmp_path / "run", "deployment.keep=last")
    for content in recommendations(run):
        assert (content["policy"], content["deployment"], content["keep"]) == (2, None, "last")


def test_tuning_goes_on_from_the_best_policy_so_far(reverting: Services) -> None:
    """The stub's policy is a digest of the one before and of the data: whose is told by it."""
    found = by_the_logs(reverting, 4)
    said = reverting.output("agent_0")
    fell_short = 0
    for k in range(1, 5):
        best = measured_returns.best(found[:k])
        line = f"deployment {k} fell short: tuning continues from policy {best - 1}"
        assert (line in said) is (best < k)
        fell_short += best < k
    assert fell_short  # or nothing was tested


@pytest.mark.parametrize(
    ("process", "moment"),
    [
        ("agent_1", ["evaluation", 4, 0]),
        pytest.param("agent_1", ["deployment", 4, LAST], marks=pytest.mark.slow),
        pytest.param("host", ["deployment", 3, 5], marks=pytest.mark.slow),
    ],
)
def test_a_run_that_reverts_ends_with_the_same_bytes_after_a_kill(
    make_run: MakeRun, reverting: Services, tmp_path: Path, process: str, moment: list[object]
) -> None:
    run = make_run(tmp_path / "run", *BEST, "deployment.revert=true")
    for name in PROCESSES:
        faults = {"kill": moment} if name == process else {}
        run.start(name, **({"stub": True} if name != "host" else {}), **faults)
    assert run.wait(process) == -signal.SIGKILL
    run.start(process, **({"stub": True} if process != "host" else {}))
    finish(run)
    assert run.result() == reverting.result()


def test_a_lost_checkpoint_of_the_best_policy_is_made_again(
    make_run: MakeRun, reverting: Services, tmp_path: Path
) -> None:
    run = make_run(tmp_path / "run", *BEST, "deployment.revert=true")
    found = by_the_logs(reverting, 4)
    k = next(
        k for k in range(2, 5) if measured_returns.best(found[:k]) < k
    )  # the first that falls short
    lost = run.folder.checkpoint("agent_1", measured_returns.best(found[:k]) - 1)
    for name in ("host", "agent_0", "agent_2"):
        run.start(name, **({"stub": True} if name != "host" else {}))
    run.start("agent_1", stub=True, kill=["deployment", k, 10])
    assert run.wait("agent_1") == -signal.SIGKILL
    lost.write_bytes(b"{corrupt")
    run.start("agent_1", stub=True)
    finish(run)
    assert "it and what follows are made again" in run.output("agent_1")
    assert run.result() == reverting.result()


def test_no_deployment_follows_one_below_the_floor(make_run: MakeRun, tmp_path: Path) -> None:
    run = undisturbed(make_run, tmp_path / "run", *BEST, "deployment.floor=1e6")
    assert run.folder.evaluation(1).exists() and run.folder.checkpoint("agent_0", 1).exists()
    assert not run.folder.deployment(2).exists()
    assert "below deployment.floor = 1e+06: none follows" in run.output("host")
    assert {content["deployment"] for content in recommendations(run)} == {1}


def test_a_floor_that_is_reached_changes_nothing(
    make_run: MakeRun, confirmed: Services, tmp_path: Path
) -> None:
    floor = ("deployment.floor=-1e6", "deployment.confirm=true")
    assert undisturbed(make_run, tmp_path / "run", *BEST, *floor).result() == confirmed.result()


def test_a_deployment_waits_for_a_person_and_nobody_gives_up(
    make_run: MakeRun, tmp_path: Path
) -> None:
    deadline = 6.0
    run = make_run(tmp_path / "run", "deployment.approve=true", f"bus.answer_deadline={deadline}")
    patience = ("--patience", "120")  # however busy the machine is
    for process in PROCESSES:
        run.start(process, *patience, **({"stub": True} if process != "host" else {}))
    run.wait_for_file(run.folder.waiting)
    content = json.loads(run.folder.waiting.read_text())
    assert (content["deployment"], content["policy"], content["measured"]) == (1, 0, None)
    assert content["approve_by"] == "deployments/approved_01"
    evaluation = json.loads(run.folder.evaluation(0).read_text())
    assert content["greedy_return"] == evaluation["mean_return"]
    handles = [os.pidfd_open(process.pid) for process in run.running.values()]
    ended, _, _ = select.select(handles, [], [], deadline + 1)
    for handle in handles:
        os.close(handle)
    assert not ended and not run.folder.deployment(1).exists()
    run.folder.approval(1).touch()
    run.wait_for_file(run.folder.deployment(1))
    run.wait_for_file(run.folder.waiting)
    content = json.loads(run.folder.waiting.read_text())
    _, first = read_measured(run.folder.deployment(1))
    assert content["measured"] == {"deployment": 1, **vars(first)}
    for process in PROCESSES:
        assert run.stop(process, signal.SIGTERM) == 128 + signal.SIGTERM
    assert not run.folder.waiting.exists()  # nobody waits any more
    run.folder.approval(2).touch()  # which holds for a host that comes later
    for process in PROCESSES:
        run.start(process, *patience, **({"stub": True} if process != "host" else {}))
    finish(run)
    assert run.folder.deployment(2).exists()
