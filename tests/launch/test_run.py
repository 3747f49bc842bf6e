"""Whole runs through the launcher: finished, interrupted, killed, and gone on with."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from otc_dist.certs import authority
from otc_dist.datasets import inputs, store
from otc_dist.datasets.importers import import_files
from otc_dist.launch.__main__ import main
from otc_dist.launch.plan import descriptions, new_folder, run_record
from otc_dist.launch.plan.ledger import Ledger
from otc_dist.launch.plan.placement import Placement
from otc_dist.launch.plan.run_record import RunRecord
from otc_dist.launch.run.resolve import resolve
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError
from tests.track.readers import READERS, measured

from .conftest import AGENTS, Hold, Launcher, processes_of, same, wait_for_end
from .namespaces import star
from .scrapes import asked_of, free_port, scraped

pytestmark = pytest.mark.slow

Launch = Callable[..., Launcher]


def test_a_run_ends_with_results_and_nothing_left(finished: tuple[RunFolder, Launcher]) -> None:
    folder, launcher = finished
    assert RunRecord.read(folder).state == "finished"
    results = json.loads(folder.results.read_text())
    assert results["complete"] and results["missing"] == []
    assert [row["deployment"] for row in results["table"]] == [0, 1, 2]
    assert "</html>" in folder.report.read_text()
    assert processes_of(folder.root) == {}
    for said in (
        "agent_1: offline",
        "agent_2: tuning after deployment 2",
        "agent_0: accepts ",
        "return, mean of",
    ):
        assert said in launcher.text
    assert str(folder.report) in launcher.lines[-1]


def test_a_run_that_is_stopped_in_every_way_leaves_no_process_and_ends_the_same(
    finished: tuple[RunFolder, Launcher],
    launch: Launch,
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One after the other, each after a resume from the one before.

    A tracker that is told of it comes with some launchers, goes with each, and holds all in the
    end; what watches the env host or shows its log changes nothing either.
    """
    folder = RunFolder(tmp_path / "run")
    port = free_port()
    beside = {
        0: ("--track", "tensorboard"),
        2: ("--prometheus", str(port)),
        3: ("--view", str(port)),
        4: ("--track", "tensorboard"),
    }
    command = ["3agent_hopper", *tiny_flags, "--out", "run"]
    moments = [
        ("agent_0", "offline", 0, "agent_0: offline", signal.SIGTERM),
        ("agent_0", "offline", 0, "agent_0: offline", signal.SIGINT),  # the others may be through
        ("host", "deployment", 1, "host: deployment 1", signal.SIGINT),
        ("agent_0", "tuning", 1, "agent_0: tuning after deployment 1", signal.SIGINT),
        ("host", "deployment", 2, "host: deployment 2", signal.SIGKILL),
    ]
    for number, (process, phase, deployment, line, by) in enumerate(moments):
        hold = Hold(process, phase, deployment, tmp_path / f"gate{number}")
        asked = beside.get(number, ())
        launcher = launch(*command, *asked, hold=hold)
        launcher.read_until(lambda status, line=line: status.startswith(line))
        running = processes_of(folder.root)
        children = list(running.values())
        assert len(children) == 4 + bool({"--track", "--view"} & set(asked))
        if number == 0:
            (tracker,) = (pid for words, pid in running.items() if "otc_dist.track" in words)
            os.kill(tracker, signal.SIGKILL)
            launcher.read_until(lambda line: line.startswith("tracking: was killed by SIGKILL; "))
        if "--prometheus" in asked:
            found = scraped(port)
            assert found["otc_phase", "deployment"] == found["otc_deployment", ""] == 1
            assert found["otc_phase_steps", ""] == 80 // 4
            assert found["otc_lock_steps_total", ""] > 0  # of evaluation 0
            evaluated = json.loads(folder.evaluation(0).read_text())
            assert found["otc_return", "greedy"] == evaluated["mean_return"]
        if "--view" in asked:
            assert f"its deployments are shown at http://127.0.0.1:{port}/" in launcher.text
            view = next(pid for words, pid in running.items() if "otc_dist.view" in words)
            assert os.getpriority(os.PRIO_PROCESS, view) == 19
            newest = json.loads(asked_of(port, "newest"))
            assert (newest["deployment"], newest["scene"]["bodies"][0]["name"]) == (1, "torso")
        launcher.process.send_signal(by)
        if by == signal.SIGKILL:  # nobody is left to stop the others in order
            wait_for_end(children)
            launcher.finish()
            assert status_of(folder.root, capsys)["state"] == "interrupted"
        else:
            assert launcher.finish() == 128 + by
            assert processes_of(folder.root) == {}
            assert RunRecord.read(folder).state == "stopped"
            assert launcher.lines[-1].startswith(
                f"stopped by {by.name}; resume with: python -m otc_dist.launch"
            )
        command = ["--resume", str(folder.root)]
    resumed = launch(*command, "--track", "tensorboard")
    assert resumed.finish() == 0, resumed.text
    same(folder, finished[0])
    assert "tracking: " not in resumed.text
    points, _ = READERS["tensorboard"](folder.tracking("tensorboard"))
    assert points == measured(finished[0])


def test_a_checkpoint_that_the_disk_damages_unseen_is_made_again(
    finished: tuple[RunFolder, Launcher],
    launch: Launch,
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
) -> None:
    """The learner goes on from what it holds, and does not read what it wrote."""
    folder = RunFolder(tmp_path / "run")
    hold = Hold("host", "deployment", 2, tmp_path / "gate")
    launcher = launch("3agent_hopper", *tiny_flags, "--out", "run", hold=hold)
    launcher.read_until(lambda line: line.startswith("host: deployment 2"))
    folder.checkpoint("agent_1", 1).write_bytes(b"")
    hold.release()
    assert launcher.finish() == 0, launcher.text
    assert "checkpoint_01.safetensors is damaged" in folder.output("agent_1").read_text()
    same(folder, finished[0])


def test_a_launcher_killed_while_the_report_is_made_goes_on_with_the_report(
    finished: tuple[RunFolder, Launcher],
    launch: Launch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The report is also what is made again of a finished run that lost it."""
    folder, reference = RunFolder(tmp_path / "run"), finished[0]
    shutil.copytree(reference.root, folder.root)
    folder.report.unlink()
    held = folder.results.with_name("results.json.partial")
    os.mkfifo(held)  # from which nobody reads: who writes the report waits there
    launcher = launch("--resume", str(folder.root))
    launcher.read_until(lambda line: line.endswith(str(folder.root)))
    assert RunRecord.read(folder).state == "reporting"
    launcher.process.kill()
    launcher.finish()  # every writer to it has ended, too
    held.unlink()
    assert status_of(folder.root, capsys)["state"] == "interrupted"

    resumed = launch("--resume", str(folder.root))
    assert resumed.finish() == 0, resumed.text
    assert str(folder.report) in resumed.lines[-1] and "agent_0" not in resumed.text
    assert RunRecord.read(folder).state == "finished"
    assert folder.results.read_bytes() == reference.results.read_bytes()
    assert folder.report.exists()


@pytest.mark.parametrize("lost", ["checkpoint", "evaluation"])
def test_a_finished_run_makes_again_what_it_has_lost(
    lost: str, finished: tuple[RunFolder, Launcher], launch: Launch, tmp_path: Path
) -> None:
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(finished[0].root, folder.root)
    if lost == "checkpoint":
        folder.checkpoint("agent_1", 2).write_bytes(b"")
    else:
        folder.evaluation(2).unlink()
    resumed = launch("--resume", str(folder.root))
    assert resumed.finish() == 0, resumed.text
    assert "it is made again" in resumed.text
    same(folder, finished[0])
    with pytest.raises(UserError, match=r"is finished; see .*report\.html"):
        main(["--resume", str(folder.root)])


def status_of(run: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """What `launch status` tells programs."""
    capsys.readouterr()
    assert main(["status", str(run), "--json"]) == 0
    status: dict[str, Any] = json.loads(capsys.readouterr().out)
    return status


def test_a_killed_child_is_started_again_and_the_run_ends_the_same(
    finished: tuple[RunFolder, Launcher],
    launch: Launch,
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Whatever the wall clock says: it is set back by an hour just before."""
    folder = RunFolder(tmp_path / "run")
    hold = Hold("agent_1", "offline", 0, tmp_path / "gate")
    launcher = launch("3agent_hopper", *tiny_flags, "--out", "run", hold=hold)
    launcher.read_until(lambda line: line.startswith("agent_1: offline"))
    hold.set_clock_back()
    status = status_of(folder.root, capsys)
    assert status["state"] == "running"
    processes = status["supervision"]["processes"]
    assert processes.keys() == {"host", *AGENTS}
    victim = processes["agent_1"]["pid"]
    assert victim in processes_of(folder.root).values()
    os.kill(victim, signal.SIGKILL)
    launcher.read_until(lambda line: line.startswith("agent_1: was killed by SIGKILL"))
    launcher.read_until(lambda line: line.startswith("agent_1: offline"))  # and held there again
    agent = status_of(folder.root, capsys)["supervision"]["processes"]["agent_1"]
    assert (agent["restarts"], agent["last_end"]) == (1, "was killed by SIGKILL")
    assert agent["pid"] != victim
    hold.release()
    assert launcher.finish() == 0, launcher.text
    same(folder, finished[0])
    assert processes_of(folder.root) == {}
    status = status_of(folder.root, capsys)
    assert (status["state"], status["supervision"]) == ("finished", None)


def test_a_run_trains_from_what_another_one_deployed(
    finished: tuple[RunFolder, Launcher],
    launch: Launch,
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
) -> None:
    logs = [finished[0].deployment(k) for k in (1, 2)]
    name = str(import_files(logs, "another-run").name)
    flags = ("dataset.name=" + name, "dataset.transitions=0", "deployment.count=1")
    assigned = [part for flag in flags for part in ("--set", flag)]
    launcher = launch("3agent_hopper", *tiny_flags, *assigned, "--out", "run")
    assert launcher.finish() == 0, launcher.text
    folder = RunFolder(tmp_path / "run")
    card = json.loads(folder.dataset_card.read_text())
    assert (card["name"], card["transitions"]) == (name, 160)
    for agent in AGENTS:  # another offline policy than B_0's, and tuned from there
        trained = [folder.checkpoint(agent, k).read_bytes() for k in (0, 1)]
        assert finished[0].checkpoint(agent, 0).read_bytes() not in trained
        assert trained[0] != trained[1]


def test_a_run_does_not_go_on_with_other_data_of_the_same_name(
    finished: tuple[RunFolder, Launcher], tmp_path: Path, tiny_flags: tuple[str, ...]
) -> None:
    """Neither its launcher, nor a learner that is started again in mid-run."""
    name = str(import_files([finished[0].deployment(1)], "swapped").name)
    chosen = (f"dataset.name={name}", "dataset.transitions=0")
    description = resolve(
        descriptions.load("3agent_hopper", (*tiny_flags[1::2], *chosen), None, quick=False)
    )
    folder = RunFolder(new_folder.make_folder(tmp_path / "run", needed=0).root)
    record = run_record.create(folder, description, quick=False, placement=Placement())
    Ledger(record, folder).note_inputs(inputs.data(description, AGENTS), description)
    shutil.rmtree(store.agent_file(name, "agent_0").parent)
    import_files([finished[0].deployment(2)], "swapped")
    says = rf"the data of agent_0 \({name}\) have changed since the run began"
    with pytest.raises(UserError, match=says):
        main(["--resume", str(folder.root)])
    learner = ("-m", "otc_dist.services.learner", "--run", str(folder.root), "--agent", "agent_0")
    done = subprocess.run([sys.executable, *learner], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and re.match(f"error: {says}", done.stderr)


def test_separate_hosts_come_to_the_bytes_of_one_machine(
    finished: tuple[RunFolder, Launcher],
    launch: Launch,
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
) -> None:
    """Each in a network of its own, with its own agent's certificate and data and nothing else.

    And though the env host is killed: all links to it are made again.
    """
    with star(len(AGENTS)) as (centre, hosts):
        list(authority.make(tmp_path / "certs", AGENTS, [host.centre for host in hosts], days=1))
        run = ("3agent_hopper", *tiny_flags, "--role")
        learners = []
        for agent, host in zip(AGENTS, hosts, strict=True):
            home = tmp_path / agent
            shutil.copytree(tmp_path / "certs" / agent, home / "certs" / agent)
            there = ("--connect", f"tls/{host.centre}:7447", "--certs", "certs", "--out", "run")
            where = {"cwd": home, "prefix": host.prefix, "cache": home / "cache"}
            learners.append(launch(*run, "learner", "--agent", agent, *there, **where))
        there = ("--listen", "tls/0.0.0.0:7447", "--certs", "certs", "--out", "run")
        hold = Hold("host", "deployment", 1, tmp_path / "gate")
        where = {"prefix": centre.prefix, "cache": tmp_path / "cache", "hold": hold}
        env_host = launch(*run, "host", *there, **where)
        env_host.read_until(lambda line: line.startswith("host: deployment 1"))
        (victim,) = processes_of(tmp_path / "run").values()
        hold.lift()
        os.kill(victim, signal.SIGKILL)
        for launcher in (env_host, *learners):
            assert launcher.finish() == 0, launcher.text
    same(
        RunFolder(tmp_path / "run"), finished[0], [RunFolder(tmp_path / a / "run") for a in AGENTS]
    )
    for agent in AGENTS:
        data = [path.name for path in (tmp_path / agent / "cache").rglob("*.safetensors")]
        assert data == [f"{agent}.safetensors"]
    assert list((tmp_path / "cache").rglob("*.safetensors")) == []
