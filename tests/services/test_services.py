"""The services as they are: real brains, one run, and what each process touched."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.bus.endpoints import local_endpoint, local_socket, remove_local_endpoint
from otc_dist.bus.keys import Keys
from otc_dist.datasets import store
from otc_dist.deployment_log.reader import read_steps
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.learner import team
from otc_dist.learner.learner import Learner

from .conftest import AGENTS, PATIENCE, Services, step_bytes


def _data_file(services: Services, agent: str, cache: Path | None = None) -> Path:
    """Where an agent's B_0 lies, in the tests' cache or in another."""
    dataset = Description.load(services.folder.description).dataset
    path = store.agent_file(dataset.name, agent, dataset.transitions)
    return cache / path.relative_to(os.environ["OTC_DIST_CACHE"]) if cache else path


@pytest.fixture(scope="module")
def finished(
    make_run: Callable[..., Services], tmp_path_factory: pytest.TempPathFactory
) -> Services:
    """A run in which each process finds its own agent's data set and no other's."""
    root = tmp_path_factory.mktemp("finished")
    services = make_run(root / "run")
    services.start("host", cache=root / "host")
    for agent in AGENTS:
        own, everybodys = _data_file(services, agent, root / agent), _data_file(services, agent)
        own.parent.mkdir(parents=True)
        shutil.copy(everybodys, own)
        services.start(agent, cache=root / agent)
    assert set(services.wait_all().values()) == {0}, services.output("host")
    return services


def test_a_run_leaves_logs_evaluations_checkpoints_and_metrics(finished: Services) -> None:
    folder = finished.folder
    for k in (0, 1, 2):
        result = json.loads(folder.evaluation(k).read_text())
        assert len(result["returns"]) == len(result["lengths"]) == len(result["seeds"]) == 2
        assert set(result["policies"]) == set(AGENTS)
        assert all(folder.checkpoint(agent, k).exists() for agent in AGENTS)
    for agent in AGENTS:
        lines = [json.loads(line) for line in folder.metrics(agent).read_text().splitlines()]
        assert {line["phase"] for line in lines} == {"offline", "dynamics", "tuning"}
        assert [line["deployment"] for line in lines if "accepted" in line["metrics"]] == [1, 2]
    assert len(finished.result()["deployment 2"]) == 80 // 4  # type: ignore[arg-type]


@pytest.mark.parametrize("agent", AGENTS)
def test_no_learner_opens_another_agents_files_or_the_logs(finished: Services, agent: str) -> None:
    folder, opened = finished.folder, finished.record(agent)["opened"]
    caches = folder.root.parent
    assert str(_data_file(finished, agent, caches / agent)) in opened
    others = [name for name in AGENTS if name != agent]
    foreign = [caches / name for name in others] + [folder.agent(name) for name in others]
    foreign += [folder.root / "deployments", folder.root / "evaluations"]
    foreign += [Path(os.environ["OTC_DIST_CACHE"])]
    assert [path for path in opened if any(path.startswith(str(f)) for f in foreign)] == []


@pytest.mark.parametrize("agent", AGENTS)
def test_no_learner_declares_another_agents_keys(finished: Services, agent: str) -> None:
    digest = Description.load(finished.folder.description).shared_digest()
    uses = Keys("tiny-run", digest).learner_uses(agent)
    assert set(finished.record(agent)["keys"]) <= set(uses.keys)


def test_the_env_host_opens_no_agents_data_and_runs_without_torch(finished: Services) -> None:
    record = finished.record("host")
    assert record["modules"] == []
    assert [path for path in record["opened"] if path.endswith(".safetensors")] == []
    agents = str(finished.folder.root / "agents")
    assert [path for path in record["opened"] if path.startswith(agents)] == []


def test_a_learner_that_compiles_nothing_does_without_torchs_compiler(finished: Services) -> None:
    """To import it takes longer than a small run's training."""
    assert finished.record("agent_0")["modules"] == ["otc_dist.learner.learner", "torch"]


def _equals_brains_in_one_process(services: Services) -> None:
    """The same run without a bus: same steps, policies and returns, to the bit."""
    description = Description.load(services.folder.description)
    spec = registry.team_spec(description.env.id)
    task = registry.task(description.env.id)
    learners = []
    for agent in spec.agents:
        data = store.load_agent(_data_file(services, agent.name), agent.name)
        learners.append(Learner(description, agent, data, task))
        learners[-1].pretrain(lambda progress: None, lambda: None)
    for k in (1, 2):
        steps = team.deploy(learners, k)
        logged = read_steps(services.folder.deployment(k))
        for ours, theirs in zip(steps, logged, strict=True):
            assert step_bytes(ours) == step_bytes(theirs)
        for index, learner in enumerate(learners):
            learner.tune(k, team.own_transitions(steps, index), lambda progress: None)
        evaluation = json.loads(services.folder.evaluation(k).read_text())
        digests = {learner.spec.name: learner.policy_digest() for learner in learners}
        assert digests == evaluation["policies"]
        played = team.evaluate(learners, k)
        assert list(played.episode_returns) == evaluation["returns"]


def test_brains_called_in_one_process_come_to_the_same_bytes(finished: Services) -> None:
    _equals_brains_in_one_process(finished)


@pytest.mark.slow
@pytest.mark.parametrize(
    "assignments",
    [
        (
            *("algorithm.name=awac", "sampling.distance=value", "algorithm.hidden=[16, 16]"),
            "deployment.exploration=sequential",
        ),
        ("algorithm.name=cql", "sampling.distance=value", "algorithm.hidden=[16, 16]"),
        ("algorithm.name=td3bc", "sampling.name=balanced", "algorithm.hidden=[16, 16]"),
        (
            *("algorithm.name=bremen", "algorithm.hidden=[16, 16]", "algorithm.models=2"),
            *("algorithm.improvements=2", "algorithm.horizon=10"),
        ),
    ],
)
def test_everything_a_description_can_ask_for_runs_on_the_bus(
    make_run: Callable[..., Services], tmp_path: Path, assignments: tuple[str, ...]
) -> None:
    """With a learner that dies on the way, in a deployment that it has seen part of."""
    services = make_run(tmp_path / "run", *assignments)
    for process in ("host", "agent_0", "agent_2"):
        services.start(process)
    services.start("agent_1", kill=["deployment", 2, 15])
    services.wait("agent_1")
    services.start("agent_1")
    assert set(services.wait_all().values()) == {0}, services.output("host")
    _equals_brains_in_one_process(services)


def test_nothing_of_the_bus_stays_behind(finished: Services) -> None:
    assert not (finished.folder.root / ".bus").exists()
    endpoint = local_endpoint(finished.folder.root)
    socket = local_socket(endpoint)
    assert socket is not None and not socket.exists()
    remove_local_endpoint(endpoint)


@pytest.mark.slow
def test_late_messages_and_a_killed_learner_change_no_byte_of_real_learning(
    run: Services, finished: Services
) -> None:
    for process in ("host", "agent_0", "agent_2"):
        run.start(process, delay=0.005)
    run.start("agent_1", kill=["deployment", 2, 10])
    run.wait("agent_1")
    run.start("agent_1")
    assert set(run.wait_all().values()) == {0}, run.output("host")
    assert run.result() == finished.result()


def _publish(finished: Services, fresh: Services, *arguments: str) -> tuple[int, str]:
    """Publish the finished run's logs to the fresh run's learners, which run already."""
    logs = [str(finished.folder.deployment(k)) for k in (1, 2)]
    command = [sys.executable, "-m", "otc_dist.replay", *logs, "--publish", "--learners"]
    command += ["--run", str(fresh.folder.root), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    return done.returncode, done.stderr


def test_a_fresh_learner_tuned_from_the_replayed_logs_ends_with_the_same_bytes(
    finished: Services, run: Services
) -> None:
    """On the real bus, without the other two: it learns nothing of them anyway."""
    run.start("agent_1")
    status, said = _publish(finished, run, "--agent", "agent_1")
    assert status == 0, said
    assert run.wait("agent_1") == 0
    for k in (0, 1, 2):
        path = finished.folder.checkpoint("agent_1", k)
        assert run.folder.checkpoint("agent_1", k).read_bytes() == path.read_bytes()


def test_another_learner_than_the_one_in_the_log_is_refused(
    finished: Services, run: Services
) -> None:
    run.start("agent_1", stub=True)
    status, said = _publish(finished, run, "--agent", "agent_1")
    assert status == 1
    assert "agent_1 acts by policy" in said and "is not the one that was there" in said
    assert said.splitlines()[-1].startswith("error: ")


def _service(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", f"otc_dist.services.{arguments[0]}", *arguments[1:]]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("service", ["env_host", "learner"])
def test_help_teaches_how_to_start_a_run_by_hand(service: str) -> None:
    shown = _service(service, "--help")
    assert shown.returncode == 0
    assert "python -m otc_dist.services.learner --run runs/my_run --agent agent_0" in shown.stdout


def test_mistakes_are_one_line_and_status_2(run: Services, tmp_path: Path) -> None:
    root = str(run.folder.root)
    cases = [
        (("env_host", "--run", str(tmp_path / "none")), "cannot read the description"),
        (("learner", "--run", root, "--agent", "agent_9"), "unknown agent 'agent_9'; did you mean"),
        (("env_host", "--run", root, "--listen", "nonsense"), "'nonsense' is not a valid endpoint"),
        (("env_host", "--run", root, "--listen", "a", "--connect", "b"), "instead of --listen"),
        (("learner", "--run", root, "--agent", "agent_0", "--insecure"), "--insecure is for an"),
    ]
    for arguments, message in cases:
        ended = _service(*arguments)
        assert (ended.returncode, ended.stdout) == (2, "")
        assert message in ended.stderr and ended.stderr.count("\n") == 1


def test_a_missing_data_file_is_the_learners_mistake_to_mend(
    make_run: Callable[..., Services], tmp_path: Path
) -> None:
    run = make_run(tmp_path / "run")
    text = run.folder.description.read_text()
    run.folder.description.write_text(text.replace("transitions = 1200", "transitions = 1234"))
    run.start("host")
    run.start("agent_0", stub=True)
    assert run.wait("agent_0") == 2
    lines = run.output("agent_0").splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ")
    run.close()
