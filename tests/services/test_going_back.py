"""Models that stay while the policy goes back: in processes that die, and in one that does not."""

import json
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.comparison import runs
from otc_dist.comparison.scores import ComparisonFolder, Run
from otc_dist.description import Description
from otc_dist.run.recommendation import reverted

from .conftest import AGENTS, PROCESSES, Services

STEPS = 80 // 4  # of a deployment
BACK = (
    *("algorithm.name=bremen", "algorithm.hidden=[16,16]", "algorithm.models=2"),
    *("algorithm.improvements=2", "algorithm.horizon=5", "algorithm.radius=0.5"),
    *("sampling.name=uniform", "sampling.online_share=0.5", "evaluation.episodes=1"),
    *("deployment.keep=best", "deployment.revert=true", "deployment.count=4"),
)


def in_one_process(description: Description, root: Path) -> Run:
    """The same, as a comparison makes it."""
    folder, seed = ComparisonFolder(root), description.seed
    for agent in AGENTS:
        runs.train_offline(folder, description, [seed], agent, lambda share, where: None)
    runs.evaluate_offline(folder, description, seed)
    return runs.run_arm(folder, description, seed, "own", (), {}, lambda share, where: None)


@pytest.mark.slow
def test_bremen_goes_back_to_the_same_policies_whoever_dies_and_in_a_comparison(
    make_run: Callable[..., Services], tmp_path: Path
) -> None:
    run = make_run(tmp_path / "run", *BACK)
    known = in_one_process(Description.load(run.folder.description), tmp_path / "compared")
    measured = [one for one in known.measured if one is not None]
    fell = next(k for k in range(2, 4) if reverted(measured[:k]) is not None)

    kills = {
        "agent_0": ["deployment", fell, STEPS],  # about to go back
        "agent_1": ["evaluation", fell, 0],  # has gone back
        "host": ["deployment", fell + 1, 5],
    }
    for process in PROCESSES:
        run.start(process, **({"kill": kills[process]} if process in kills else {}))
    for process in kills:
        assert run.wait(process) == -signal.SIGKILL, run.output(process)
        run.start(process)
    assert set(run.wait_all().values()) == {0}, run.output("host") + run.output("agent_0")

    for k, expected in enumerate(known.evaluations):
        found = json.loads(run.folder.evaluation(k).read_text())
        assert (found["policies"], found["returns"]) == (expected.policies, expected.returns), k
    kept = json.loads(run.folder.recommended("agent_0").read_text())
    assert kept["deployment"] == known.best
