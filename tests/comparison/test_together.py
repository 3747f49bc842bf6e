"""Several seeds' offline policies in one process, as on a GPU; here it runs eagerly on the CPU."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from otc_dist.comparison import arms as arms_of
from otc_dist.comparison import offline_cache, runs, spent
from otc_dist.comparison.arms import KNOWN, REFERENCE
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.comparison.spent import Spent
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.launch.compare import job, job_graph, rates
from otc_dist.launch.compare.comparison import Comparison, jobs_of
from otc_dist.launch.supervise.jobs import Job
from otc_dist.learner import checkpoint
from otc_dist.system.processor import processor

from .conftest import SEEDS, VERSIONS, silent

AGENT = "agent_1"


@pytest.fixture(scope="module")
def trained(base: Description, tmp_path_factory: pytest.TempPathFactory) -> ComparisonFolder:
    """pi_0 of one agent under both seeds, by one job."""
    folder = ComparisonFolder(tmp_path_factory.mktemp("together"))
    folder.description.write_text(base.to_toml())
    output = folder.output(SEEDS[-1], f"offline_{AGENT}")
    output.parent.mkdir()
    assert job.main([str(folder.root), "0,1", str(output), "offline", AGENT]) == 0
    shares = [spent.read(spent.beside(folder.output(s, f"offline_{AGENT}"))) for s in SEEDS]
    assert shares[0] and shares[0].seeds == len(SEEDS) and shares[0] == shares[1]
    return folder


def test_what_is_stored_is_what_each_seed_stores_alone(
    trained: ComparisonFolder, finished: ComparisonFolder
) -> None:
    """Equal up to rounding, of which the fits to B_0, made one by one, have none."""
    for seed in SEEDS:
        paths = [folder.seed(seed).checkpoint(AGENT, 0) for folder in (finished, trained)]
        (expected, alone), (found, together) = map(checkpoint.read, paths)
        unknown = {"similarity": 0.0}  # nothing is similar before the first deployment: NaN
        assert not alone.together
        assert {**vars(alone), "together": SEEDS, **unknown} == {**vars(together), **unknown}
        assert expected.keys() == found.keys()
        for key, array in expected.items():
            rounding = {"rtol": 1e-4, "atol": 2e-5} if key.startswith("algorithm.") else {"rtol": 0}
            np.testing.assert_allclose(found[key], array, **rounding, err_msg=key)
        assert not trained.seed(seed).offline_checkpoint(AGENT).exists()


def test_scores_say_with_which_seeds_pi_0_was_trained(
    trained: ComparisonFolder, finished: ComparisonFolder, base: Description, tmp_path: Path
) -> None:
    folder = ComparisonFolder(tmp_path)
    shutil.copytree(finished.seed(0).root, folder.seed(0).root)
    shutil.copy(trained.seed(0).checkpoint(AGENT, 0), folder.seed(0).checkpoint(AGENT, 0))
    runs.evaluate_offline(folder, base, 0)
    found = runs.run_arm(folder, base, 0, REFERENCE, KNOWN[REFERENCE], VERSIONS, silent)
    assert found.together == list(SEEDS) and found.read(folder.run(0, REFERENCE)) == found
    assert found.read(finished.run(0, REFERENCE)).together == []


def test_a_process_that_had_written_one_of_them_makes_the_other(
    trained: ComparisonFolder, base: Description, tmp_path: Path
) -> None:
    cut = ComparisonFolder(tmp_path)
    made = cut.seed(SEEDS[0]).checkpoint(AGENT, 0)
    made.parent.mkdir(parents=True)
    made.write_bytes(b"is left alone")
    seen: list[str] = []
    assert not runs.train_offline(cut, base, SEEDS, AGENT, lambda share, where: seen.append(where))
    assert made.read_bytes() == b"is left alone" and seen[0].startswith("offline ")
    assert checkpoint.read(cut.seed(SEEDS[1]).checkpoint(AGENT, 0))[1].tuned == 0


def test_the_cache_tells_with_which_seeds_a_policy_was_trained(
    trained: ComparisonFolder,
    base: Description,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(offline_cache, "cache_root", lambda: tmp_path / "cache")
    made, wanted = trained.seed(0).checkpoint(AGENT, 0), tmp_path / "wanted.safetensors"
    offline_cache.keep(base, AGENT, made, SEEDS)
    for others in ((), (0,), (0, 1, 2)):
        assert not offline_cache.fetch(base, AGENT, wanted, others)
    assert offline_cache.fetch(base, AGENT, wanted, (1, 0))
    assert wanted.read_bytes() == made.read_bytes()


def offline(jobs: list[Job]) -> dict[str, Job]:
    return {job.name: job for job in jobs if " offline" in job.name}


def test_on_a_gpu_the_seeds_of_each_ten_are_trained_by_one_job_an_agent(
    base: Description, tmp_path: Path
) -> None:
    on_gpu = base.with_assignments("engine.name=cuda-graph")
    folder, arms = ComparisonFolder(tmp_path), arms_of.parse_arms("uniform,typical-offline")
    agents = registry.team_spec(base.env.id).names
    compared = Comparison(folder, on_gpu, arms, (8, 9, 10), quick=True)
    jobs = jobs_of([compared])
    names = [f"{seeds}, {agent} offline" for seeds in ("seeds 8,9", "seed 10") for agent in agents]
    # Which rows are typical depends on the seed.
    names += [f"seed {s}, {a} offline for typical-offline" for s in (8, 9, 10) for a in agents]
    assert sorted(offline(jobs)) == sorted(names)
    assert len({job.output for job in jobs}) == len(jobs)
    first = offline(jobs)["seeds 8,9, agent_1 offline"]
    assert first.command[-4:] == ("8,9", str(first.output), "offline", "agent_1")
    assert first.product == folder.seed(9).checkpoint("agent_1", 0)  # which is written last
    needs = {job.name: job.needs for job in jobs}
    for seed in (8, 9):
        assert first.product in needs[f"seed {seed}, evaluation of pi_0"]
    # What is there stays, and the others are trained without it.
    made = folder.seed(8).checkpoint("agent_1", 0)
    made.parent.mkdir(parents=True)
    made.touch()
    done = {name: job.done for name, job in offline(compared.jobs((8, 9))).items()}
    assert done["seed 8, agent_1 offline"] and not done["seed 9, agent_1 offline"]
    assert not done["seeds 8,9, agent_0 offline"]
    assert sorted(offline(job_graph.mechanism(folder, on_gpu, (8, 9), "name", ()))) == [
        "seed 8, agent_1 offline",
        "seed 9, agent_1 offline",
        "seeds 8,9, agent_0 offline",
        "seeds 8,9, agent_2 offline",
    ]
    assert sorted(offline(job_graph.comparison(folder, base, arms, (0, 1))))[0] == (
        "seed 0, agent_0 offline"
    )


def test_what_a_job_of_several_seeds_took_is_shared_out_among_them(
    base: Description, tmp_path: Path
) -> None:
    """Nine took twice as long as forecast: so will the tenth, alone, and the next nine together."""
    on_gpu = base.with_assignments("engine.name=cuda-graph", "algorithm.name=bremen")
    folder, seeds = ComparisonFolder(tmp_path), tuple(range(19))
    compared = Comparison(folder, on_gpu, arms_of.parse_arms("uniform"), seeds, quick=True)
    name = f"seeds {','.join(map(str, range(10, 19)))}, {AGENT} offline"
    nine = offline(jobs_of([compared]))[name]
    share = Spent(2 * nine.seconds / 9, processor(), seeds=9)
    for seed in range(9):
        made = folder.seed(seed).checkpoint(AGENT, 0)
        made.parent.mkdir(parents=True)
        made.touch()
        share.write(spent.beside(folder.output(seed, f"offline_{AGENT}")))
    jobs = jobs_of([compared])
    took = rates.read(jobs)
    assert rates.hours(jobs, took) * 3600 == pytest.approx(2 * nine.seconds)
    before, now = offline(jobs), offline(rates.measured([compared], jobs, took))
    for left in (f"seed 9, {AGENT} offline", name):
        assert now[left].seconds == pytest.approx(2 * before[left].seconds)
