"""Beside a run: what is asked for wrongly is one line, and what fails there harms nothing."""

import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from otc_dist.bus.messages import Status
from otc_dist.launch.__main__ import main
from otc_dist.launch.plan.beside import Beside, Companion
from otc_dist.launch.run.companions import Companions
from otc_dist.launch.supervise import supervisor
from otc_dist.launch.supervise.signals import Signals
from otc_dist.run.folder import RunFolder
from otc_dist.services.exposition import Counts, exposed
from otc_dist.system import extras
from otc_dist.system.ports import Port
from otc_dist.terminal.errors import UserError

from .scrapes import free_port, scraped


@pytest.fixture
def taken() -> Iterator[int]:
    with socket.socket() as there:
        there.bind(("127.0.0.1", 0))
        there.listen()
        yield there.getsockname()[1]


@pytest.mark.parametrize("flag", ["--prometheus", "--view"])
@pytest.mark.parametrize("dry", [[], ["--dry-run"]])
def test_a_port_that_is_taken_is_one_line_before_anything_is_made(
    taken: int, tmp_path: Path, dry: list[str], flag: str
) -> None:
    out = tmp_path / "run"
    with pytest.raises(UserError) as refused:
        main(["navigation", "--quick", flag, str(taken), "--out", str(out), *dry])
    assert str(refused.value) == f"cannot listen at 127.0.0.1:{taken}: Address already in use"
    assert not out.exists()


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--prometheus", "metrics"], "'metrics' is no port"),
        (["--prometheus", "0"], "'0' is no port"),
        (["--prometheus", "65536"], "'65536' is no port"),
        (["--prometheus", ":9400"], "':9400' is no HOST:PORT"),
        (["--prometheus", "::1:9400"], "'::1:9400' is no HOST:PORT"),
        (["--prometheus", "no.such.host.invalid:9400"], "cannot listen at no.such.host"),
        (["--track", "mlfow"], "invalid choice: 'mlfow'"),
        (
            [
                *("--role", "learner", "--agent", "agent_0", "--connect", "tcp/127.0.0.1:7447"),
                *("--insecure", "--prometheus", "9400"),
            ],
            "--prometheus is for where the env host is",
        ),
        (["--view", "navigation"], "'navigation' is no port"),
        (
            [
                *("--view", "--set", "env.id=mpe2.simple_spread_v3:parallel_env"),
                *("--set", "algorithm.name=discrete-cql"),
            ],
            "there is nothing to view: the states of mpe2",
        ),
        (
            [
                *("--role", "learner", "--agent", "agent_0", "--connect", "tcp/127.0.0.1:7447"),
                *("--insecure", "--view", "8700"),
            ],
            "--view is for where the env host is",
        ),
    ],
)
def test_what_is_asked_for_wrongly_is_one_line(flags: list[str], says: str) -> None:
    with pytest.raises(UserError, match=says):
        main(["navigation", "--quick", *flags])


@pytest.mark.parametrize("flags", [["--track", "mlflow"], ["--prometheus", "9400"]])
def test_without_the_package_nothing_is_made_and_one_line_says_what_to_install(
    flags: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda package: None)
    with pytest.raises(UserError, match=r"needs the package .*: .* -m pip install "):
        main(["navigation", "--quick", "--out", str(tmp_path / "run"), *flags])
    assert not (tmp_path / "run").exists()


def test_ports_are_of_the_loopback_unless_another_host_is_asked_for() -> None:
    assert Port.parse("9400") == Port("127.0.0.1", 9400)
    assert Port.parse("0.0.0.0:9400") == Port("0.0.0.0", 9400)
    assert str(Port.parse("[::1]:9400")) == "[::1]:9400"


def test_prometheus_reads_what_the_statuses_tell_and_what_is_counted() -> None:
    now = [Status("host", "deployment", 2, 5, 20, 3.5, awaits=("agent_1",))]
    counts = [Counts(45, 7, {"run": 3}, {"greedy": 1.5})]
    port = Port("127.0.0.1", free_port())
    with exposed(port, "a-run", lambda: now[0], lambda: counts[0]):
        assert scraped(port.number) == {
            ("otc_phase", "deployment"): 1,
            ("otc_deployment", ""): 2,
            ("otc_step", ""): 5,
            ("otc_phase_steps", ""): 20,
            ("otc_lock_steps_per_second", ""): 3.5,
            ("otc_awaited_agents", ""): 1,
            ("otc_lock_steps_total", ""): 45,
            ("otc_messages_resent_total", ""): 7,
            ("otc_messages_rejected_total", "run"): 3,
            ("otc_return", "greedy"): 1.5,
        }
        with (
            pytest.raises(UserError, match=r"cannot listen at .*: Address already in use"),
            exposed(port, "another", lambda: now[0], lambda: counts[0]),
        ):
            pass
    port.check_free()


# Say by a FIFO that they are there, so that nobody stops them before.
_HANGS = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {there}; signal.pause()"
_WAITS = (
    "import signal, sys; signal.signal(signal.SIGTERM, lambda *_: sys.exit()); {there};"
    " signal.pause()"
)
_FAILS = "import sys; {there}; sys.exit('error: the disk is full')"


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (_WAITS, None),
        (_HANGS, "tracking: was killed by SIGKILL; the run does not need it"),
        (_FAILS, "tracking: exited with status 1 (the disk is full); the run does not need it"),
    ],
    ids=["ends", "hangs", "fails"],
)
def test_a_companion_that_hangs_or_fails_is_one_line_and_ends_with_the_launcher(
    code: str,
    said: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    fifo = tmp_path / "there"
    os.mkfifo(fifo)
    command = (sys.executable, "-c", code.format(there=f"open({str(fifo)!r}, 'w').close()"))
    made = Companion("tracking", command, "all is written by hand")
    monkeypatch.setattr(Beside, "companions", lambda *_: [made])
    if code == _HANGS:
        monkeypatch.setattr(supervisor, "GRACE", 0.1)
    with Signals() as signals:
        with Companions(Beside("mlflow"), RunFolder(tmp_path), signals) as companions:
            fifo.open().close()
            while code == _FAILS and not (lines := companions.events()):
                signals.wait(60.0)
        shown = capfd.readouterr().out
    if code == _FAILS:
        assert shown == "" and lines == [f"{said}, and all is written by hand"]
    elif said is None:
        assert shown == ""
    else:
        assert shown.startswith(said) and shown.count("\n") == 1
