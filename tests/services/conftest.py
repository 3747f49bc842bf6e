"""Runs of real processes: an env host and its learners, with faults where a test asks for them."""

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from otc_dist.bus.endpoints import local_endpoint, remove_local_endpoint
from otc_dist.datasets import store
from otc_dist.deployment_log.reader import read_steps
from otc_dist.description import Description
from otc_dist.run.folder import RunFolder
from otc_dist.transitions import JointStep

PATIENCE = 600.0  # seconds; only a test that fails waits as long
AGENTS = ("agent_0", "agent_1", "agent_2")
PROCESSES = ("host", *AGENTS)
WRAPPED = Path(__file__).with_name("wrapped.py")


def step_bytes(step: JointStep) -> list[bytes]:
    """A logged step, to the bit: every array's bytes, field by field."""
    values = [getattr(step, field.name) for field in fields(step)]
    arrays = [part for value in values for part in (value if type(value) is tuple else (value,))]
    return [np.asarray(array).tobytes() for array in arrays]


class Services:
    """The processes of one run folder."""

    def __init__(self, folder: RunFolder) -> None:
        self.folder = folder
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def start(
        self, process: str, *arguments: str, cache: Path | None = None, **faults: Any
    ) -> None:
        """Start `process`, "host" or an agent's name; what it prints goes to the run's output.

        `cache`: a cache of data sets other than that of all tests.
        """
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        if cache is not None:
            environment["OTC_DIST_CACHE"] = str(cache)
        service = ["env_host"] if process == "host" else ["learner", "--agent", process]
        output = self.folder.output(process)
        output.parent.mkdir(exist_ok=True)
        command = [sys.executable, str(WRAPPED), str(self.record_file(process))]
        command += [json.dumps(faults), *service, "--run", str(self.folder.root), *arguments]
        with output.open("ab") as sink:
            self.running[process] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=sink,
                env=environment,
            )

    def start_all(self, **faults: Any) -> None:
        for process in PROCESSES:
            self.start(process, **faults)

    def wait(self, process: str) -> int:
        """The exit status of `process`."""
        return self.running[process].wait(PATIENCE)

    def wait_all(self) -> dict[str, int]:
        return {process: self.wait(process) for process in list(self.running)}

    def stop(self, process: str, number: signal.Signals) -> int:
        self.running[process].send_signal(number)
        return self.wait(process)

    def wait_for_file(self, path: Path, process: str = "host") -> None:
        """Return when `path` exists; fail if `process` ends before."""
        handle = os.pidfd_open(self.running[process].pid)
        try:
            waited = 0.0
            while not path.exists():
                ended, _, _ = select.select([handle], [], [], 0.01)
                waited += 0.01
                assert path.exists() or not ended, self.output(process)
                assert waited < PATIENCE, f"{path} did not appear"
        finally:
            os.close(handle)

    def output(self, process: str) -> str:
        return self.folder.output(process).read_text(errors="replace")

    def record_file(self, process: str) -> Path:
        return self.folder.root / f"record_{process}.json"

    def record(self, process: str) -> dict[str, list[str]]:
        """What a process that has ended opened and declared."""
        found: dict[str, list[str]] = json.loads(self.record_file(process).read_text())
        return found

    def result(self) -> dict[str, object]:
        """All that must be the same in every run of a seed, as bytes."""
        description = Description.load(self.folder.description)
        found: dict[str, object] = {}
        for agent in AGENTS:
            found[f"{agent} recommends"] = self.folder.recommended(agent).read_bytes()
        for k in range(description.deployment.total + 1):
            if k <= description.deployment.count:
                for agent in AGENTS:
                    found[f"{agent} {k}"] = self.folder.checkpoint(agent, k).read_bytes()
                found[f"evaluation {k}"] = self.folder.evaluation(k).read_bytes()
            if k:
                found[f"deployment {k}"] = [
                    step_bytes(step) for step in read_steps(self.folder.deployment(k))
                ]
        return found

    def close(self) -> None:
        for process in self.running.values():
            if process.poll() is None:
                process.kill()
                process.wait()
        remove_local_endpoint(local_endpoint(self.folder.root))


@pytest.fixture(scope="session")
def make_run() -> Iterator[Callable[..., Services]]:
    """Make a tiny run's folder; its processes are gone when the tests end."""
    made: list[Services] = []

    def make(root: Path, *assignments: str) -> Services:
        from tests.conftest import TINY

        data: dict[str, object] = {
            "name": "tiny",
            "env": {"id": "hopper-3x1"},
            "dataset": {"name": "hopper-3x1/random"},
        }
        description = Description.build(data, [*TINY, "bus.answer_deadline=120.0", *assignments])
        store.ensure(description.dataset.name, description.dataset.transitions)
        root.mkdir(parents=True)
        folder = RunFolder(root)
        folder.description.write_text(description.to_toml())
        folder.run_json.write_text(json.dumps({"run": "tiny-run"}))
        made.append(Services(folder))
        return made[-1]

    yield make
    for services in made:
        services.close()


@pytest.fixture
def run(make_run: Callable[..., Services], tmp_path: Path) -> Iterator[Services]:
    """A tiny run of the test's own."""
    services = make_run(tmp_path / "run")
    yield services
    services.close()


@pytest.fixture(scope="session")
def undisturbed(
    make_run: Callable[..., Services], tmp_path_factory: pytest.TempPathFactory
) -> Services:
    """A run with the small brain in which nothing went wrong."""
    services = make_run(tmp_path_factory.mktemp("undisturbed") / "run")
    services.start_all(stub=True)
    assert set(services.wait_all().values()) == {0}, services.output("host")
    return services
