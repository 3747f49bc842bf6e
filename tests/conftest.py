"""What all tests share: they leave the user's cache alone, and have one thread, as learners do."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

# Before torch is imported. As many test processes as cores, each with as many threads, wait for
# one another most of the time.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# The smallest run with every phase.
TINY = (
    "algorithm.name=td3bc",  # with a Q, so that every distance can serve
    "dataset.transitions=1200",
    "embedding.updates=20",
    "dynamics.updates=20",
    "dynamics.correction_updates=20",
    "offline.updates=60",
    "algorithm.batch_size=32",
    "sampling.candidates=64",
    "sampling.references=64",
    "sampling.similarity_sample=500",
    "deployment.count=2",
    "deployment.transitions=80",
    "deployment.updates=20",
    "evaluation.episodes=2",
    "engine.name=eager",
)

# Where files are shared out among processes, the longest come first: else one works on alone.
LONGEST = (
    *("services/test_services.py", "launch/test_run.py", "services/test_faults.py"),
    *("launch/test_going_on.py", "launch/test_keep.py", "test_readme.py"),
    *("comparison/test_command.py", "launch/test_tasks.py", "launch/test_chaos.py"),
    *(
        "launch/test_ssh.py",
        "steps/test_engine.py",
        "learner/test_learner.py",
        "deployment_log/test_recovery.py",
    ),
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    places = {Path(__file__).parent / name: n for n, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(LONGEST)))


@pytest.fixture(scope="session", autouse=True)
def cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of this test session's own, for these processes and those that they start."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OTC_DIST_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="session")
def tiny_flags() -> tuple[str, ...]:
    """Flags that turn a description of a robot into a run of seconds, with every phase."""
    return tuple(part for value in TINY for part in ("--set", value))


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks and checkpoints of a learner in the proportions of a real run, ten times smaller."""
    for user in ("learner.trainer", "otc.distances.embedding", "otc.forward"):
        monkeypatch.setattr(f"otc_dist.{user}.BLOCK", 10)
    monkeypatch.setattr("otc_dist.learner.learner.SAVE_EVERY", 10)
