"""Runs on several hosts, as typed: what each flag asks for, and what is wrong with the others."""

import os
import re
from pathlib import Path

import pytest

from otc_dist.certs import authority
from otc_dist.launch.__main__ import main
from otc_dist.launch.plan.new_folder import NewFolder
from otc_dist.launch.plan.plan import Plan
from otc_dist.launch.plan.run_record import RunRecord
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError

RUN = ("3agent_hopper", "--set", "dataset.transitions=100", "--set", "engine.name=eager")
HOST = ("--role", "host", "--listen", "tls/0.0.0.0:7447", "--certs", "certs")
OTHER, CONNECT = ("--role", "learner", "--agent"), ("--connect", "tls/192.0.2.1:7447")
LEARNER = (*OTHER, "agent_1", *CONNECT)
FILE = """\
env_host = "ana@192.0.2.1"
python = ".venv/bin/python"
directory = "otc"
[learners]
agent_0 = "192.0.2.2"
agent_1 = "ana@192.0.2.3"
agent_2 = "ana@192.0.2.3"
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With certificates for all, and the example's hosts.toml."""
    monkeypatch.chdir(tmp_path)
    list(authority.make(tmp_path / "certs", ["agent_0", "agent_1", "agent_2"], ["192.0.2.1"], 1))
    (tmp_path / "hosts.toml").write_text(FILE)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--role", "hots"], "invalid choice: 'hots'"),
        (["--role", "host"], "--role host needs --listen ENDPOINT"),
        (["--role", "host", "--connect", "tls/a:1"], "--connect is for --role learner"),
        (["--role", "host", "--listen", "tls/0.0.0.0:7447"], "needs --certs DIR"),
        (["--role", "host", "--listen", "tls/0.0.0.0", "--certs", "certs"], "has no port"),
        (["--role", "host", "--listen", "0.0.0.0:7447"], "'0.0.0.0:7447' is not a valid endpoint"),
        (["--role", "host", "--listen", "tcp/0.0.0.0:7447"], "or use --insecure"),
        ([*HOST, "--insecure"], "contradict each other"),
        ([*HOST, "--agent", "agent_0"], "--agent is for --role learner"),
        ([*HOST, "--set", "bus.router=tls/192.0.2.9:7447"], "leave out --listen or bus.router"),
        ([*HOST[:-1], "nowhere"], "nowhere/host/authority.pem is missing"),
        (["--role", "learner"], "--role learner needs --agent"),
        (["--role", "learner", "--agent", "agent_0"], "needs --connect ENDPOINT, the env host's"),
        ([*LEARNER, "--listen", "tls/0.0.0.0:7447"], "--listen is for --role host"),
        ([*OTHER, "agent_3", *CONNECT, "--certs", "certs"], "unknown agent 'agent_3'; did you"),
        (["--agent", "agent_1"], "--agent is for --role learner"),
        (["--listen", "tls/0.0.0.0:7447"], "--listen is for --role host"),
        (["--certs", "certs"], "--certs is for runs on several hosts"),
        (["--insecure"], "--insecure is for runs on several hosts"),
        (["--set", "bus.router=tcp/192.0.2.9:7447"], "is open to everybody who can reach it"),
        (["--hosts", "nowhere.toml"], "cannot read nowhere.toml"),
        (["--hosts", "hosts.toml", *HOST], "--hosts says what each host does: leave out --role"),
        (["--ssh"], "--ssh needs --hosts FILE"),
    ],
)
def test_a_mistake_is_one_line_before_anything_is_begun(
    arguments: list[str], says: str, folder: Path
) -> None:
    with pytest.raises(UserError) as caught:
        main([*RUN, *arguments])
    assert says in str(caught.value) and "\n" not in str(caught.value)
    assert {path.name for path in folder.iterdir()} == {"certs", "hosts.toml"}


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('agent_2 = "ana@192.0.2.3"\n', "", "names no host for agent_2"),
        ("agent_2", "agent_7", "unknown agent 'agent_7'"),
        ("python", "pyton", "unknown key 'pyton'; did you mean 'python'?"),
        ("python = ", "port = 0\npython = ", "port: input should be greater than or equal to 1"),
        ("[learners]", "[learners", "is not valid TOML"),
        ("ana@192.0.2.1", "", "env_host: '' is not a host name or an IP address, with or"),
        ("ana@192.0.2.1", "ana@", "env_host: 'ana@' is not a host name"),
        ("ana@192.0.2.1", "-oProxyCommand=x@192.0.2.1", "x@192.0.2.1' is not a host name"),
        ("192.0.2.2", "-oProxyCommand=x", "learners.agent_0: '-oProxyCommand=x' is not a host"),
        ("192.0.2.2", "d;rm", "'d;rm' is not a host name"),
        ("192.0.2.2", "192.0.2.2.", "'192.0.2.2.' is not a host name"),
    ],
)
def test_a_wrong_hosts_file_is_one_line(old: str, new: str, says: str, folder: Path) -> None:
    (folder / "hosts.toml").write_text(FILE.replace(old, new))
    with pytest.raises(UserError) as caught:
        main([*RUN, "--hosts", "hosts.toml"])
    assert says in str(caught.value) and "\n" not in str(caught.value)


def test_the_addresses_of_ipv6_are_in_brackets_before_a_colon(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "hosts.toml").write_text(FILE.replace("192.0.2.", "2001:db8::"))
    assert main([*RUN, "--hosts", "hosts.toml"]) == 0
    said = capsys.readouterr().out
    assert "--listen tls/[::]:7447" in said.replace("'", "")
    assert "--connect tls/[2001:db8::1]:7447" in said.replace("'", "")
    assert "--host 2001:db8::1\n" in said and "on ana@2001:db8::3:\n" in said
    assert "ssh ana@2001:db8::3 mkdir -p otc/certs" in said
    assert "scp -r certs/agent_1 ana@[2001:db8::3]:otc/certs/" in said


def _plan(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main([*RUN, *arguments, "--dry-run"]) == 0
    return capsys.readouterr().out


def test_a_host_starts_the_env_host_alone_and_needs_no_data(
    capsys: pytest.CaptureFixture[str],
) -> None:
    plan = _plan(capsys, *HOST)
    assert "services.env_host" in plan and "--listen tls/0.0.0.0:7447" in plan
    assert "runs/3agent_hopper-seed0-host\n" in plan  # not that of a run on this machine alone
    assert "services.learner" not in plan and "otc_dist.datasets" not in plan
    assert "safetensors" not in plan
    assert "\nfirst\n" not in plan and "what the data take" not in plan  # there is nothing to make


def test_a_learners_host_makes_and_names_its_own_data_alone(
    capsys: pytest.CaptureFixture[str],
) -> None:
    plan = _plan(capsys, *LEARNER, "--certs", "certs")
    assert "--agent agent_1 --connect tls/192.0.2.1:7447" in plan
    assert "datasets make hopper-3x1/medium-replay --transitions 100 --agent agent_1" in plan
    assert "services.env_host" not in plan and "runs/3agent_hopper-seed0-agent_1" in plan
    assert re.search("otc/3agent_hopper-seed0/[0-9a-f]{16}/agent_1/observation", plan)
    assert "agent_0" not in plan and "agent_2" not in plan


def test_a_host_need_not_have_an_imported_data_set(capsys: pytest.CaptureFixture[str]) -> None:
    assert "mine" in _plan(capsys, *HOST, "--set", "dataset.name=hopper-3x1/mine")
    unsized = ("--set", "dataset.name=hopper-3x1/mine", "--set", "dataset.transitions=0")
    with pytest.raises(UserError, match="is not on this machine: give its size"):
        main([*RUN, *HOST, *unsized])


def test_all_processes_go_to_the_router_of_the_description(
    capsys: pytest.CaptureFixture[str],
) -> None:
    plan = _plan(capsys, "--set", "bus.router=tls/192.0.2.1:7447", "--certs", "certs")
    assert plan.count("--connect tls/192.0.2.1:7447") == 4
    assert "--listen" not in plan


def test_insecure_is_said_loudly(capsys: pytest.CaptureFixture[str]) -> None:
    main([*RUN, "--hosts", "hosts.toml", "--insecure"])
    said = capsys.readouterr()
    assert "WARNING: --insecure: nothing on the network is encrypted or checked" in said.err
    assert said.out.count("--insecure") == 4 and "certs" not in said.out


def test_hosts_prints_what_to_type_where(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*RUN, "--hosts", "hosts.toml"]) == 0
    lines = capsys.readouterr().out.splitlines()
    typed = "cd otc && .venv/bin/python -m otc_dist.launch " + " ".join(RUN)
    assert lines[lines.index("on ana@192.0.2.1:") + 1] == f"  {typed} " + " ".join(HOST)
    assert lines[lines.index("on ana@192.0.2.3:") + 1] == (
        f"  {typed} {' '.join(LEARNER)} --certs certs"
    )
    assert "  python -m otc_dist.certs certs --agents 3 --host 192.0.2.1" in lines


def _fake_ssh(folder: Path, script: str) -> None:
    tool = folder / "ssh"
    tool.write_text(f"#!/bin/sh\nfor last; do machine=$command; command=$last; done\n{script}\n")
    tool.chmod(0o755)


def test_ssh_runs_each_command_on_its_host(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _fake_ssh(folder, 'echo "$*"')
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    assert main([*RUN, "--hosts", "hosts.toml", "--ssh"]) == 0
    printed = (folder / "runs" / "hosts-output" / "agent_1.log").read_text()
    assert " -- ana@192.0.2.3 cd otc && .venv/bin/python -m otc_dist.launch" in printed
    assert "--role learner --agent agent_1" in printed


def test_a_host_that_ssh_cannot_reach_ends_all(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    _fake_ssh(folder, "case $machine in 192.0.2.2) echo no route; exit 255;; esac; exec sleep 600")
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    assert main([*RUN, "--hosts", "hosts.toml", "--ssh"]) == 1
    said = capfd.readouterr().err
    assert "error: agent_0 on 192.0.2.2 exited with status 255; all others are stopped" in said
    assert "no route" in said


def test_the_same_command_goes_on_with_a_part_of_a_run(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And may have moved to another address meanwhile."""
    planned: list[Plan] = []

    def run_plan(plan: Plan, record: RunRecord, *new: NewFolder) -> int:
        planned.append(plan)
        return 0

    monkeypatch.setattr("otc_dist.launch.run.command.run_plan", run_plan)
    out = ("--certs", "certs", "--out", "run")
    assert main([*RUN, *LEARNER, *out]) == 0
    before = RunRecord.read(RunFolder(folder / "run"))
    moved = ("agent_1", "--connect", "tls/192.0.2.7:7447")
    assert main([*RUN, *OTHER, *moved, *out]) == 0
    after = RunRecord.read(RunFolder(folder / "run"))
    assert (before.run, len(before.resumed), before.place.connect) == (
        "3agent_hopper-seed0",
        0,
        "tls/192.0.2.1:7447",
    )
    assert (after.run, len(after.resumed), after.place.connect) == (
        "3agent_hopper-seed0",
        1,
        "tls/192.0.2.7:7447",
    )
    assert main(["--resume", "run"]) == 0
    assert planned[2].processes == planned[1].processes != planned[0].processes
    for other in ([*OTHER, "agent_2", *CONNECT], [*LEARNER, "--seed", "5"]):
        with pytest.raises(UserError, match="is of another run, or of another part"):
            main([*RUN, *other, *out])
