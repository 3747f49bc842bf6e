"""A report names the policy to take, and tells what every deployment measured."""

import json

import pytest

from otc_dist.launch.show.summary import summary_lines

from .test_report import report


def test_every_deployment_is_told_with_its_error_beside_the_greedy_return(made) -> None:
    results, page = report(made)
    told = [(row["deployment"], row["policy"], row["mean"]) for row in results["measured"]]
    assert told == [(1, 0, pytest.approx(2)), (2, 1, pytest.approx(6)), (3, 2, pytest.approx(3))]
    assert [row["error"] for row in results["measured"]] == pytest.approx([1, 2, 1])
    assert [row["greedy_return"] for row in results["measured"]] == [-20, -10, 10]
    assert {(row["episodes"], row["horizon"]) for row in results["measured"]} == {(2, 8)}
    assert "What deployments measured" in page.text
    assert ("class", "bar s0") in page.attributes  # error bars
    assert "± error" in page.text and "2 (recommended)" in page.text


def test_the_best_deployed_policy_is_recommended_in_every_place(made) -> None:
    results, page = report(made)
    kept = results["recommended"]
    assert (kept["deployment"], kept["policy"], kept["keep"]) == (2, 1, "best")
    assert (kept["mean"], kept["error"], kept["greedy_return"]) == pytest.approx((6, 2, -10))
    assert kept["checkpoints"]["agent_1"] == "agents/agent_1/checkpoint_01.safetensors"
    assert "recommended: the policy of deployment 2, pi_1" in page.text
    *_, line, _ = summary_lines(made.folder)
    assert line == (
        "recommended: the policy of deployment 2 (agents/*/checkpoint_01.safetensors), measured"
        " 6.0 ± 2.0 over the first 8 steps of 2 episodes"
    )


def test_pi_0_can_be_the_best(made) -> None:
    made.folder.deployment(1).unlink()
    made.deploy(1, [10.0, 12.0])
    results, _ = report(made)
    assert (results["recommended"]["deployment"], results["recommended"]["policy"]) == (1, 0)


def test_the_last_tuned_policy_is_recommended_though_it_was_not_deployed(made) -> None:
    made.describe("deployment.keep=last")
    results, page = report(made)
    kept = results["recommended"]
    assert (kept["deployment"], kept["policy"], kept["mean"]) == (None, 3, None)
    assert kept["greedy_return"] == 20
    assert "the last tuned policy, pi_3, which was not deployed" in page.text
    assert "recommended: the last tuned policy (agents/*/checkpoint_03.safetensors), which" in (
        "\n".join(summary_lines(made.folder))
    )


def test_a_confirmed_policy_can_be_recommended(made) -> None:
    made.describe("deployment.confirm=true")
    results, _ = report(made)
    assert results["complete"] is False  # deployment 4 is to come
    made.deploy(4, [20.0, 22.0])
    results, _ = report(made)
    assert results["complete"] is True and results["deployments"] == 4
    assert (results["recommended"]["deployment"], results["recommended"]["policy"]) == (4, 3)
    made.describe("deployment.keep=last")
    results, _ = report(made)
    assert (results["recommended"]["deployment"], results["recommended"]["policy"]) == (4, 3)


def test_a_run_that_the_floor_ended_is_complete_and_says_why(made) -> None:
    made.describe("deployment.floor=3.5")
    made.write_record(state="finished")
    made.describe("deployment.count=10")
    results, page = report(made)
    assert results["complete"] is True
    assert (results["stopped"]["deployment"], results["stopped"]["floor"]) == (3, 3.5)
    assert results["recommended"]["deployment"] == 2
    assert "Deployments ended early:" in page.text and "not complete" not in page.text
    assert "no more deployments: deployment 3 measured 3, below deployment.floor = 3.500" in (
        "\n".join(summary_lines(made.folder))
    )


def test_nothing_is_stopped_by_a_floor_after_the_last_deployment(made) -> None:
    made.describe("deployment.floor=100")
    assert report(made)[0]["stopped"] is None


def test_where_tuning_went_back_it_is_told_from_where(made) -> None:
    back = "Tuning went back to the best policy deployed so far: pi_3 comes from pi_1."
    page = report(made)[1].text
    assert "tuning continued from" not in page and "Tuning went back" not in page
    assert not any(line.startswith("Tuning went back") for line in summary_lines(made.folder))
    made.describe("deployment.revert=true")
    results, page = report(made)
    assert [row["reverted_to"] for row in results["measured"]] == [None, None, 1]
    assert "tuning continued from" in page.text
    assert back in page.text and back in summary_lines(made.folder)


def test_a_damaged_log_is_told_and_what_lies_before_it_counts(made) -> None:
    made.folder.deployment(2).write_bytes(b"nothing")
    results, _ = report(made)
    assert [row["deployment"] for row in results["measured"]] == [1, 3]
    assert results["recommended"]["deployment"] == 1
    assert len(results["missing"]) == 1
    assert results["missing"][0].startswith("deployment_02.mcap cannot be read")


def test_a_deployment_with_one_episode_measures_nothing(made) -> None:
    made.describe("deployment.keep=last")
    made.folder.deployment(2).unlink()
    made.deploy(2, [4.0])
    results, _ = report(made)
    assert [row["deployment"] for row in results["measured"]] == [1, 3]
    assert results["missing"] == []


def test_an_agent_explores_and_nothing_is_measured(made) -> None:
    made.describe("deployment.keep=last", "deployment.exploration=sequential")
    results, page = report(made)
    assert results["measured"] == [] and "What deployments measured" not in page.text
    assert json.loads(made.folder.results.read_text())["recommended"]["policy"] == 3
