"""A run's parts started elsewhere: by OpenSSH, over TLS or a router, and by a real SLURM."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from otc_dist.bus.access import router_rules
from otc_dist.bus.keys import ANY, Keys
from otc_dist.certs import authority
from otc_dist.run.folder import RunFolder
from tests.bus.conftest import free_port

from .conftest import AGENTS, Hold, Launcher, processes_of, same, wait_for_end
from .secure_shell import hosts_by_ssh
from .slurm_node import cluster

pytestmark = pytest.mark.slow

CENTRE = "127.0.0.1"
MACHINES = {"agent_0": "127.0.0.2", "agent_1": "127.0.0.3", "agent_2": "127.0.0.3"}
RUN = "3agent_hopper-seed0"
# A router of somebody else's: Zenoh's own, configured as docs/hosts.md says and by nothing of ours.
ROUTER = """\
import sys, threading, zenoh
with zenoh.open(zenoh.Config.from_file(sys.argv[1])):
    print("ready", flush=True)
    threading.Event().wait()
"""


@contextmanager
def router(folder: Path, port: int) -> Iterator[None]:
    """A Zenoh router by TLS, with the env host's certificate and the printed rules."""
    own = folder / "certs" / "host"
    settings: Mapping[str, object] = {
        "mode": "router",
        "listen": {"endpoints": [f"tls/0.0.0.0:{port}"]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "link": {
                "tls": {
                    "root_ca_certificate": str(own / "authority.pem"),
                    "listen_certificate": str(own / "certificate.pem"),
                    "listen_private_key": str(own / "key.pem"),
                    "enable_mtls": True,
                }
            }
        },
        "access_control": router_rules(Keys(RUN, ANY), AGENTS),
    }
    (folder / "router.json5").write_text(json.dumps(settings))
    command = [sys.executable, "-c", ROUTER, str(folder / "router.json5")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == b"ready\n"
            yield
        finally:
            process.kill()


@pytest.mark.parametrize("meets_at", ["env host", "router"])
def test_a_run_by_ssh_is_stopped_and_gone_on_with_and_ends_the_same(
    meets_at: str,
    finished: tuple[RunFolder, Launcher],
    launch: Callable[..., Launcher],
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    there, port = tmp_path / "there", free_port()
    list(authority.make(there / "certs", AGENTS, [CENTRE], days=1))
    lines = [f'env_host = "{CENTRE}"', f"port = {port}", f'directory = "{there}"']
    lines += [f'python = "{sys.executable}"', "[learners]"]
    lines += [f'{agent} = "{machine}"' for agent, machine in MACHINES.items()]
    (tmp_path / "hosts.toml").write_text("\n".join(lines))
    command = ["3agent_hopper", *tiny_flags, "--hosts", "hosts.toml", "--ssh"]
    if meets_at == "router":
        command += ["--set", f"bus.router=tls/{CENTRE}:{port}"]
    runs = there / "runs"
    host, learners = runs / f"{RUN}-host", [runs / f"{RUN}-{agent}" for agent in AGENTS]
    with ExitStack() as stack:
        hold = Hold("host", "deployment", 1, tmp_path / "gate")
        machines = {CENTRE, *MACHINES.values()}
        tools = stack.enter_context(hosts_by_ssh(tmp_path / "ssh", machines, hold.environment))
        monkeypatch.setenv("PATH", f"{tools}{os.pathsep}{os.environ['PATH']}")
        if meets_at == "router":
            stack.enter_context(router(there, port))
        first = launch(*command)
        first.read_until(lambda line: line.startswith("host: deployment 1"))
        working = [pid for run in (host, *learners) for pid in processes_of(run).values()]
        assert len(working) == 1 + len(AGENTS)
        first.process.send_signal(signal.SIGINT)
        assert first.finish() == 128 + signal.SIGINT, first.text
        assert "the same command continues" in first.text
        wait_for_end(working)
        hold.lift()
        again = launch(*command)
        assert again.finish() == 0, again.text
    said = [first.text, again.text]
    said += [(tmp_path / "runs" / "hosts-output" / f"{agent}.log").read_text() for agent in AGENTS]
    assert not any("\x1b" in text for text in said)  # lines: no table is drawn into a file
    same(RunFolder(host), finished[0], [RunFolder(folder) for folder in learners])


def test_a_run_across_a_slurm_allocation_is_stopped_and_gone_on_with_and_ends_the_same(
    finished: tuple[RunFolder, Launcher],
    launch: Callable[..., Launcher],
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (folder := tmp_path / "there").mkdir()
    command = [sys.executable, "-m", "otc_dist.launch", "3agent_hopper", *tiny_flags]
    alone = subprocess.run([*command, "--on", "slurm"], cwd=folder, capture_output=True, text=True)
    assert alone.returncode == 2 and "begin with salloc" in alone.stderr
    runs = [RunFolder(folder / "runs" / f"{RUN}-{part}") for part in ("host", *AGENTS)]
    hold = Hold("host", "deployment", 1, tmp_path / "gate")
    with cluster(tmp_path) as environment:
        monkeypatch.setenv("SLURM_CONF", environment["SLURM_CONF"])

        def start() -> Launcher:
            flags = ("3agent_hopper", *tiny_flags, "--on", "slurm")
            return launch(*flags, cwd=folder, prefix=("salloc", "--quiet"), hold=hold)

        first = start()
        first.read_until(lambda line: line.startswith("host: deployment 1"))
        working = [pid for run in runs for pid in processes_of(run.root).values()]
        assert len(working) == 1 + len(AGENTS)
        salloc = first.process.pid
        (launcher,) = Path(f"/proc/{salloc}/task/{salloc}/children").read_text().split()
        os.kill(int(launcher), signal.SIGINT)
        assert first.finish() == 128 + signal.SIGINT, first.text
        assert "the same command continues" in first.text
        wait_for_end(working)
        hold.lift()
        again = start()  # an allocation of another number
        assert again.finish() == 0, again.text
    same(runs[0], finished[0], runs[1:])
    key = folder / "runs" / f"{RUN}-certs" / "agent_0" / "key.pem"
    assert key.stat().st_mode & 0o077 == 0
