"""A finished comparison of two seeds and three arms, tiny and eager, made in this process."""

from pathlib import Path

import pytest

from otc_dist.comparison import arms as arms_of
from otc_dist.comparison import runs
from otc_dist.comparison.arms import Arms
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.launch.plan import descriptions
from otc_dist.launch.run.resolve import resolve

SEEDS = (0, 1)
VERSIONS = {"otc-dist": "test"}


def silent(share: float, where: str) -> None:
    assert 0 <= share <= 1, where


@pytest.fixture(scope="session")
def base(tiny_flags: tuple[str, ...], cache_folder: Path) -> Description:
    description = resolve(descriptions.load("3agent_hopper", tiny_flags[1::2], None, quick=True))
    store.ensure(description.dataset.name, description.dataset.transitions)
    return description


@pytest.fixture(scope="session")
def arms() -> Arms:
    return arms_of.parse_arms("otc-embedding")


@pytest.fixture(scope="session")
def finished(
    tmp_path_factory: pytest.TempPathFactory, base: Description, arms: Arms
) -> ComparisonFolder:
    folder = ComparisonFolder(tmp_path_factory.mktemp("comparison"))
    folder.description.write_text(base.to_toml())
    for seed in SEEDS:
        for agent in registry.team_spec(base.env.id).names:
            runs.train_offline(folder, base, (seed,), agent, silent)
        runs.evaluate_offline(folder, base, seed)
        for arm, assignments in arms.items():
            runs.run_arm(folder, base, seed, arm, assignments, VERSIONS, silent)
    return folder
