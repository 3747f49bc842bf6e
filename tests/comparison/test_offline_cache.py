"""Offline policies shared across comparisons: the same bytes, whatever becomes of the cache."""

import json
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from otc_dist.comparison import offline_cache, runs
from otc_dist.comparison.arms import KNOWN, REFERENCE, Arms
from otc_dist.comparison.offline_cache import fetch, keep
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.launch.__main__ import main
from otc_dist.launch.compare import job_graph
from otc_dist.terminal.errors import UserError

from .conftest import VERSIONS, silent


@pytest.fixture
def made(finished: ComparisonFolder) -> Path:
    """pi_0 of agent_0, seed 0."""
    return finished.seed(0).checkpoint("agent_0", 0)


@pytest.fixture
def policies(
    base: Description, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """The folder of a cache that holds nothing but `made`."""
    monkeypatch.setattr(offline_cache, "cache_root", lambda: tmp_path / "cache")
    keep(base, "agent_0", made)
    return tmp_path / "cache" / "policies"


def test_a_comparison_with_policies_of_another_has_the_same_raw_scores(
    finished: ComparisonFolder, base: Description, arms: Arms, tmp_path: Path
) -> None:
    other = ComparisonFolder(tmp_path)
    other.description.write_text(base.to_toml())
    agents = registry.team_spec(base.env.id).names
    taken = [other.seed(0).checkpoint(agent, 0) for agent in agents]
    assert job_graph.take_offline(other, base, arms, (0,)) == taken
    assert job_graph.take_offline(other, base, arms, (0,)) == []
    left = [job.name for job in job_graph.comparison(other, base, arms, (0,)) if not job.done]
    assert left == ["seed 0, evaluation of pi_0", *(f"seed 0, arm {arm}" for arm in arms)]
    for agent in agents:
        files = (folder.seed(0).checkpoint(agent, 0) for folder in (finished, other))
        assert len({path.read_bytes() for path in files}) == 1
    runs.evaluate_offline(other, base, 0)
    runs.run_arm(other, base, 0, REFERENCE, KNOWN[REFERENCE], VERSIONS, silent)
    assert other.offline(0).read_bytes() == finished.offline(0).read_bytes()
    found = [json.loads(folder.run(0, REFERENCE).read_text()) for folder in (finished, other)]
    assert found[0] | {"seconds": 0} == found[1] | {"seconds": 0}


def _another_s_run(folder: ComparisonFolder) -> str:
    """Before any job: there is a run of that name, of another description."""
    shutil.rmtree(folder.seed(1).root)
    shutil.copy(folder.run(0, "uniform"), folder.run(0, "mine"))
    return "mine.json is of another description; delete it, or use another --out"


def _another_s_evaluation(folder: ComparisonFolder) -> str:
    """By the first job."""
    shutil.rmtree(folder.seed(1).root)
    folder.seed(1).root.mkdir()
    shutil.copy(folder.offline(0), folder.offline(1))
    return "pi_0.json is of other policies; delete it"


@pytest.mark.parametrize("mistake", [_another_s_run, _another_s_evaluation])
def test_what_is_added_to_a_comparison_and_refused_leaves_nothing_new_in_it(
    mistake: Callable[[ComparisonFolder], str],
    finished: ComparisonFolder,
    tiny_flags: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = ComparisonFolder(tmp_path / "begun")
    shutil.copytree(finished.root, folder.root)
    # Also what other tests left, with commands of their own.
    for made in (folder.results, folder.report, folder.inputs, folder.root / ".lock"):
        made.unlink(missing_ok=True)
    expected = mistake(folder)
    before = {*folder.root.rglob("*")}
    added = ("--arm", "mine=sampling.name=otc", "--arms", "uniform", "--seeds", "0,1")
    command = ["compare", "3agent_hopper", "--out", str(folder.root), *added]
    try:
        assert main([*command, "--quick", *tiny_flags]) == 2
        said = capsys.readouterr().err
    except UserError as error:
        said = str(error)
    assert expected in said
    left = {path for path in folder.root.rglob("*") if path.name not in (".lock", "inputs.json")}
    assert left == before


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda content: content[:-1] + bytes([content[-1] ^ 1]), "wrong digest"),
        (lambda content: content[: len(content) // 2], "is damaged"),
        (lambda content: b"", "is damaged"),
    ],
)
def test_a_damaged_entry_is_one_line_and_made_again(
    policies: Path,
    base: Description,
    made: Path,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    damage: Callable[[bytes], bytes],
    told: str,
) -> None:
    (entry,) = policies.iterdir()
    entry.write_bytes(damage(entry.read_bytes()))
    wanted = tmp_path / "agents" / "checkpoint.safetensors"
    assert not fetch(base, "agent_0", wanted)
    (record,) = caplog.records
    said = record.getMessage()
    assert said.startswith("an offline policy is trained again:") and told in said
    assert "\n" not in said
    assert not list(policies.iterdir()) and not list(wanted.parent.iterdir())
    keep(base, "agent_0", made)
    assert fetch(base, "agent_0", wanted) and wanted.read_bytes() == made.read_bytes()


def test_another_s_policy_is_not_taken(
    policies: Path, base: Description, finished: ComparisonFolder, tmp_path: Path
) -> None:
    (entry,) = policies.iterdir()
    entry.write_bytes(finished.seed(0).checkpoint("agent_1", 0).read_bytes())
    assert not fetch(base, "agent_0", tmp_path / "checkpoint.safetensors")


@pytest.mark.parametrize("differs", ["seed", "settings", "agent", "processor", "package", "data"])
def test_what_its_bytes_depend_on_tells_entries_apart(
    policies: Path,
    base: Description,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    differs: str,
) -> None:
    description, agent, wanted = base, "agent_0", tmp_path / "checkpoint.safetensors"
    assert fetch(description, agent, wanted)
    if differs in ("seed", "settings"):
        change = "seed=1" if differs == "seed" else "algorithm.discount=0.5"
        description = base.with_assignments(change)
    elif differs == "agent":
        agent = "agent_1"
    elif differs == "processor":
        monkeypatch.setenv("MKL_CBWR", "COMPATIBLE")
    elif differs == "package":
        monkeypatch.setattr(offline_cache, "_package", lambda: "another commit's")
    else:
        path = store.agent_file(base.dataset.name, agent, base.dataset.transitions)
        other = tmp_path / "data.safetensors"
        other.write_bytes(path.read_bytes() + b"other")
        monkeypatch.setattr(store, "agent_file", lambda *arguments: other)
    assert not fetch(description, agent, wanted)
    assert len(list(policies.iterdir())) == 1  # and the other one stays


def test_what_was_not_used_for_longest_goes_first(
    policies: Path,
    base: Description,
    made: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (policies / "unfinished.1234").write_bytes(bytes(made.stat().st_size))
    for age, path in enumerate(sorted(policies.iterdir())):
        os.utime(path, (1000 + age, 1000 + age))
    assert fetch(base, "agent_0", tmp_path / "checkpoint.safetensors")  # used
    monkeypatch.setattr(offline_cache, "LIMIT", 2 * made.stat().st_size)
    keep(base, "agent_1", made)
    assert len(list(policies.iterdir())) == 2
    assert fetch(base, "agent_0", tmp_path / "checkpoint.safetensors")


def test_many_at_once_take_whole_policies_or_none(
    policies: Path,
    base: Description,
    made: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(offline_cache, "LIMIT", 0)  # whatever is kept goes at once
    content = made.read_bytes()

    def use(number: int) -> bool:
        keep(base, "agent_0", made)
        wanted = tmp_path / f"{number}.safetensors"
        return not fetch(base, "agent_0", wanted) or wanted.read_bytes() == content

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(use, range(40)))
    assert not caplog.records and not list(policies.iterdir())


def test_a_cache_that_cannot_be_written_is_one_line(
    policies: Path, base: Description, made: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for path in policies.iterdir():
        path.unlink()
    policies.rmdir()
    policies.touch()
    keep(base, "agent_0", made)
    (record,) = caplog.records
    assert record.getMessage().startswith("an offline policy is not kept for other comparisons:")
