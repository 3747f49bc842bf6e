"""Whatever happens to messages and processes, the run ends with the same bytes."""

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.bus.wire import PROTOCOL_VERSION
from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.reader import read_header
from otc_dist.replay.recover import recover
from tests.deployment_log.conftest import again

from .conftest import AGENTS, PROCESSES, Services


def test_lost_and_late_messages_only_cost_time(run: Services, undisturbed: Services) -> None:
    run.start_all(stub=True, drop=1, delay=0.002)
    assert set(run.wait_all().values()) == {0}, run.output("host")
    assert run.result() == undisturbed.result()


slow = pytest.mark.slow
ROUTER = Path(__file__).with_name("router.py")
LAST = 80 // 4  # the question that carries a deployment's last outcome
MOMENTS = [
    pytest.param(["evaluation", 0, 3], marks=slow),
    ["deployment", 2, 10],
    pytest.param(["deployment", 1, LAST], marks=slow),
    pytest.param(["evaluation", 1, 0], marks=slow),
    pytest.param(["done", 2, 0], marks=slow),
]


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_killed_learner_that_is_restarted_ends_with_the_same_bytes(
    run: Services, undisturbed: Services, moment: list[object]
) -> None:
    for process in ("host", "agent_0", "agent_2"):
        run.start(process, stub=True)
    run.start("agent_1", stub=True, kill=moment)
    assert run.wait("agent_1") == -signal.SIGKILL
    run.start("agent_1", stub=True)
    assert set(run.wait_all().values()) == {0}, run.output("host")
    assert run.result() == undisturbed.result()


@pytest.mark.parametrize("k", [1, 2])
def test_a_checkpoint_that_the_disk_damages_is_made_again_before_its_learner_leaves(
    run: Services, undisturbed: Services, tmp_path: Path, k: int
) -> None:
    """Also the last one: nobody reads it any more, and only the env host's log can repair it."""
    gate = tmp_path / "gate"
    os.mkfifo(gate)
    run.start("host", hold=["done", 2, 0, str(gate)])
    for agent in AGENTS:
        run.start(agent, stub=True)
    run.wait_for_file(run.folder.evaluation(2))
    run.folder.checkpoint("agent_1", k).write_bytes(b"")
    gate.open("w").close()
    assert set(run.wait_all().values()) == {0}, run.output("host")
    assert run.result() == undisturbed.result()
    assert f"checkpoint_0{k}.safetensors is corrupt: it and what follows" in run.output("agent_1")


def test_a_policy_that_another_kind_of_processor_trained_again_goes_on(
    run: Services, tmp_path: Path
) -> None:
    """The run has been told of: where none has, it would be a fault of ours."""
    record = json.loads(run.folder.run_json.read_text())
    run.folder.run_json.write_text(json.dumps({**record, "processors": ["one", "another"]}))
    gate = tmp_path / "gate"
    os.mkfifo(gate)
    run.start("host", hold=["deployment", 1, 10, str(gate)])
    for agent in AGENTS:
        run.start(agent, stub=True)
    with gate.open("w"):  # the host has come to it, and waits
        run.stop("agent_1", signal.SIGKILL)
        run.folder.checkpoint("agent_1", 0).unlink()
        run.start("agent_1", stub="elsewhere")
    assert set(run.wait_all().values()) == {0}, run.output("host")
    said = run.output("host")
    assert "than it began deployment 1 with" in said and "on this kind of processor" in said
    assert "did not repeat itself" not in said


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_killed_env_host_that_is_restarted_ends_with_the_same_bytes(
    run: Services, undisturbed: Services, moment: list[object]
) -> None:
    run.start("host", kill=moment)
    for agent in AGENTS:
        run.start(agent, stub=True)
    assert run.wait("host") == -signal.SIGKILL
    run.start("host")
    assert set(run.wait_all().values()) == {0}, run.output("host")
    assert run.result() == undisturbed.result()


def test_a_stopped_run_goes_on_where_it_was(
    run: Services, undisturbed: Services, tmp_path: Path
) -> None:
    """What Ctrl-C and --resume do: all processes end in order, and start again later."""
    os.mkfifo(tmp_path / "gate")
    run.start("host", hold=["deployment", 1, 10, str(tmp_path / "gate")])
    for agent in AGENTS:
        run.start(agent, stub=True)
    run.wait_for_file(partial_path(run.folder.deployment(1)))
    for process in PROCESSES:
        assert run.stop(process, signal.SIGTERM) == 128 + signal.SIGTERM
        assert "Traceback" not in run.output(process)
    assert not run.folder.evaluation(1).exists()
    run.start_all(stub=True)
    assert set(run.wait_all().values()) == {0}, run.output("host")
    assert run.result() == undisturbed.result()


@slow
def test_a_finished_run_is_over_at_once(run: Services, undisturbed: Services) -> None:
    run.start_all(stub=True)
    run.wait_all()
    before = run.result()
    run.start_all(stub=True)
    assert set(run.wait_all().values()) == {0}
    assert run.result() == before == undisturbed.result()


@slow
def test_a_corrupt_checkpoint_is_made_again(run: Services, undisturbed: Services) -> None:
    run.start_all(stub=True)
    run.wait_all()
    run.folder.checkpoint("agent_1", 2).write_bytes(b"{corrupt")
    run.folder.checkpoint("agent_1", 1).unlink()
    run.start_all(stub=True)
    assert set(run.wait_all().values()) == {0}, run.output("agent_1")
    assert "corrupt; trying an older one" in run.output("agent_1")
    assert run.folder.checkpoint("agent_1", 2).read_bytes() == (
        undisturbed.folder.checkpoint("agent_1", 2).read_bytes()
    )


def test_a_log_that_does_not_come_out_again_is_refused(run: Services) -> None:
    """As when the simulator's version changed between a crash and the resumption."""
    run.start("host", kill=["deployment", 1, 10])
    for agent in AGENTS:
        run.start(agent, stub=True)
    assert run.wait("host") == -signal.SIGKILL
    assert partial_path(run.folder.deployment(1)).exists()
    text = run.folder.description.read_text()
    for agent in AGENTS:
        run.stop(agent, signal.SIGTERM)
    run.folder.description.write_text(text.replace("seed = 0", "seed = 1", 1))
    run.start("host")
    assert run.wait("host") == 1
    assert "does not come out as it was logged" in run.output("host").splitlines()[-1]
    run.folder.description.write_text(text)
    again(partial_path(run.folder.deployment(1)), run="another-run")
    run.start("host")
    assert run.wait("host") == 1
    assert "is of run another-run, deployment 1, not of" in run.output("host").splitlines()[-1]
    # What is recovered of it is not the deployment that the others would learn from.
    recover(partial_path(run.folder.deployment(1)), run.folder.deployment(1), force=False)
    run.start("host")
    assert run.wait("host") == 2
    last = run.output("host").splitlines()[-1]
    assert "is partial: 10 of 20 steps; the whole deployment is needed" in last


def test_a_full_disk_is_one_line_and_loses_nothing(run: Services, undisturbed: Services) -> None:
    """Also if what had been written is of the older form, which the log then keeps."""
    run.start("host", full_disk=10)
    for agent in AGENTS:
        run.start(agent, stub=True)
    assert run.wait("host") == 1
    last = run.output("host").splitlines()[-1]
    assert last.startswith("error: cannot write") and "No space left on device" in last
    assert "Traceback" not in run.output("host")
    again(partial_path(run.folder.deployment(1)), format_version=1)
    run.start("host")
    assert set(run.wait_all().values()) == {0}, run.output("host")
    assert run.result() == undisturbed.result()
    assert "steps stay unbound to this run" in run.output("host")
    assert [read_header(run.folder.deployment(k)).format_version for k in (1, 2)] == [1, 2]


def test_a_learner_that_never_answers_ends_the_run_with_its_name(
    make_run: Callable[..., Services], tmp_path: Path
) -> None:
    run = make_run(tmp_path / "run", "bus.answer_deadline=4.0")
    patience = ("--patience", "120")  # to come, however busy the machine is
    for process in ("host", "agent_0", "agent_2"):
        run.start(process, *patience, stub=True)
    run.start("agent_1", *patience, stub=True, mute=True)
    assert run.wait("host") == 1
    last = run.output("host").splitlines()[-1]
    assert last.startswith("error: no answer from agent_1 for 4 s")
    assert "evaluation 0, step 0" in last
    # The learners notice that the host is gone, and say so.
    for agent in AGENTS:
        assert run.wait(agent) == 1
        assert "nothing was heard of the env host for 4 s" in run.output(agent)


def test_another_protocol_version_is_refused_in_one_sentence(run: Services) -> None:
    run.start("host")
    run.start("agent_0", stub=True, version=7)
    assert run.wait("agent_0") == 2
    last = run.output("agent_0").splitlines()[-1]
    assert f"protocol version {PROTOCOL_VERSION} and this one 7: install the same version" in last
    assert run.running["host"].poll() is None


def test_a_router_between_all_processes_changes_no_byte_even_if_it_is_killed(
    run: Services, undisturbed: Services, tmp_path: Path
) -> None:
    """Somebody else's router, with Zenoh's own defaults; nobody listens but that."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"

    def route() -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, ROUTER, endpoint])

    gate, router = tmp_path / "gate", route()
    os.mkfifo(gate)
    held = {"hold": ["deployment", 1, 10, str(gate)]}
    try:
        for process in PROCESSES:
            faults = held if process == "host" else {"stub": True}
            run.start(process, "--connect", endpoint, "--insecure", **faults)
        run.wait_for_file(partial_path(run.folder.deployment(1)))
        router.kill()
        router.wait()
        router = route()
        gate.open("w").close()
        assert set(run.wait_all().values()) == {0}, run.output("host")
    finally:
        router.kill()
        router.wait()
    assert run.result() == undisturbed.result()
    assert "WARNING: --insecure: anyone who reaches" in run.output("agent_0")
