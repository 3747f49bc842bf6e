"""Every description runs to its end through the real services, and its logs can be verified."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.launch.plan import descriptions
from otc_dist.replay.__main__ import main as replay
from otc_dist.run.folder import RunFolder

from .conftest import Launcher

SMALL = (
    *("algorithm.hidden=[16,16]", "algorithm.batch_size=16", "engine.name=eager"),
    *("dataset.transitions=2000", "embedding.updates=20", "embedding.minimum_active=0"),
    *("dynamics.updates=20", "dynamics.correction_updates=20"),
    *("sampling.candidates=32", "sampling.references=32", "sampling.similarity_sample=100"),
    *("offline.updates=20", "deployment.count=1", "deployment.transitions=200"),
    *("deployment.updates=10", "evaluation.episodes=2"),
)
BREMEN = ("algorithm.models=2", "algorithm.improvements=1", "algorithm.horizon=5")
# With something else in each than the description has, so that all is tried on some task.
VARIANTS = {
    "1agent_halfcheetah": (
        *("algorithm.name=awac", "sampling.name=uniform", "sampling.online_share=0.5"),
    ),
    "1agent_hopper": ("algorithm.name=cql", "sampling.name=online-only"),
    "1agent_walker2d": ("algorithm.name=td3bc", "sampling.name=balanced"),
    "2agent_halfcheetah": ("dataset.name=random", "sampling.distance=value"),
    "2agent_walker2d": (
        *("dataset.name=medium", "deployment.exploration=sequential", "deployment.revert=false"),
        *("sampling.distance=dynamics", "sampling.acceptance=conformal", "sampling.level=0.1"),
        *BREMEN,
    ),
    "3agent_hopper": ("algorithm.name=bremen", *BREMEN),
    "5m_vs_6m": ("sampling.distance=dynamics", "sampling.acceptance=share"),
    "cooperative_navigation": ("env.agents=2", "algorithm.name=td3bc", "sampling.distance=value"),
    "navigation": ("deployment.exploration=sequential", "sampling.adaptive=false"),
    "predator_prey": ("env.agents=5", "deployment.turns=true", *BREMEN),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(descriptions.shipped()))
def test_every_description_runs(name: str, launch: Callable[..., Launcher], tmp_path: Path) -> None:
    flags = [word for value in (*SMALL, *VARIANTS.get(name, ())) for word in ("--set", value)]
    launcher = launch(name, *flags, "--out", "run")
    assert launcher.finish() == 0, launcher.text
    folder = RunFolder(tmp_path / "run")
    assert json.loads(folder.results.read_text())["complete"]
    assert replay([str(folder.deployment(1)), "--verify"]) == 0
