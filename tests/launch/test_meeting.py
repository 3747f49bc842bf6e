"""A learner apart from its env host says whom it waits for, or at once why it is not let in."""

import os
import queue
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.bus.endpoints import Endpoint, parse_endpoint
from otc_dist.bus.identity import Identity
from otc_dist.bus.keys import HOST, Keys
from otc_dist.bus.links import QUICK_PAYLOAD
from otc_dist.bus.session import Session
from otc_dist.certs import authority
from otc_dist.launch.__main__ import main
from otc_dist.launch.plan.new_folder import NewFolder
from otc_dist.launch.plan.plan import Plan
from otc_dist.launch.plan.run_record import RunRecord
from otc_dist.launch.supervise import observer
from otc_dist.launch.supervise.observer import Link, Sign, Token, Waiting, nobody_of_run, observing
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError
from tests.bus.conftest import free_port

from .conftest import AGENTS, Launcher

PATIENCE = 60.0  # seconds; only a test that fails waits as long
LEARNER = ("3agent_hopper", "--role", "learner", "--agent", "agent_0", "--out", "run", "--connect")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With certificates of our authority, and of another, one of them out of date."""
    monkeypatch.chdir(tmp_path)
    for name, days in (("certs", 30.0), ("theirs", 30.0), ("expired", -0.5)):
        list(authority.make(tmp_path / name, AGENTS, ["127.0.0.1"], days))
    return tmp_path


@pytest.fixture
def port() -> int:
    return free_port()


def _host(folder: Path, port: int, whose: str) -> Session:
    """An env host's session with the certificates of that folder, which nobody has checked."""
    if whose == "nobody's":
        return Session.listen([Endpoint(f"tcp/127.0.0.1:{port}")], QUICK_PAYLOAD)
    own = folder / whose / HOST
    identity = Identity(own / "authority.pem", own / "certificate.pem", own / "key.pem")
    return Session.listen([Endpoint(f"tls/127.0.0.1:{port}", identity)], QUICK_PAYLOAD)


@pytest.mark.parametrize(
    ("whose", "protocol", "safety", "says"),
    [
        ("theirs", "tls", ("--certs", "certs"), "is refused: unable to get local issuer"),
        ("expired", "tls", ("--certs", "expired"), "expired on"),
        ("nobody's", "tls", ("--certs", "certs"), "does not speak TLS: does it run with --ins"),
        ("certs", "tcp", ("--insecure",), "speaks TLS: use tls/127.0.0.1"),
        ("certs", "tls", (), "needs --certs DIR"),
    ],
)
def test_a_link_that_is_refused_is_one_line_before_anything_is_made(
    whose: str,
    protocol: str,
    safety: tuple[str, ...],
    says: str,
    folder: Path,
    port: int,
    launch: Callable[..., Launcher],
) -> None:
    there = f"{protocol}/127.0.0.1:{port}"
    with _host(folder, port, whose):
        launcher = launch(*LEARNER, there, *safety, cache=folder / "cache")
        assert launcher.finish() == 2, launcher.text
    said = [line for line in launcher.lines if not line.startswith("WARNING: --insecure")]
    assert len(said) == 1 and said[0].startswith("error: ") and says in said[0]
    made = [path.name for path in (folder / "cache").glob("*")]  # to choose an engine
    assert not (folder / "run").exists() and set(made) <= {f"compiled-{os.getuid()}"}


def test_a_learner_says_at_once_for_whom_it_waits(
    folder: Path, port: int, launch: Callable[..., Launcher], tiny_flags: tuple[str, ...]
) -> None:
    there = f"tls/127.0.0.1:{port}"
    cache = folder / "cache"
    launcher = launch(*LEARNER, there, "--certs", "certs", *tiny_flags, cache=cache)
    launcher.read_until(lambda line: line.startswith("making"))
    assert launcher.lines[-2].startswith(f"waiting for {there}: nobody answers there yet; start")


@pytest.fixture
def plan(folder: Path, port: int, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """Of a learner's launcher that has begun when nobody was there."""
    planned: list[Plan] = []

    def run_plan(plan: Plan, record: RunRecord, *new: NewFolder) -> int:
        planned.append(plan)
        return 0

    monkeypatch.setattr("otc_dist.launch.run.command.run_plan", run_plan)
    sized = ("--set", "dataset.transitions=100")
    assert main([*LEARNER, f"tls/127.0.0.1:{port}", "--certs", "certs", *sized]) == 0
    return planned[0]


def test_who_goes_on_is_refused_as_soon_and_nothing_is_changed(
    plan: Plan, folder: Path, port: int
) -> None:
    before = RunRecord.read(RunFolder(folder / "run"))
    with _host(folder, port, "theirs"), pytest.raises(UserError, match="is refused"):
        main(["--resume", "run"])
    assert RunRecord.read(RunFolder(folder / "run")) == before


def test_whom_it_waits_for_is_said_from_time_to_time_until_the_link_is_there(
    plan: Plan, folder: Path, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    signs: queue.SimpleQueue[Sign | Waiting] = queue.SimpleQueue()

    def until(*wanted: Link | Token) -> list[Sign | Waiting]:
        """What came until all of these had come."""
        came: list[Sign | Waiting] = []
        while not set(wanted) <= set(came):
            came.append(signs.get(timeout=PATIENCE))
        return came

    def waits() -> bool:
        came = signs.get(timeout=PATIENCE)
        return isinstance(came, Waiting) and came.line.startswith(said)

    monkeypatch.setattr(observer, "REPORT_EVERY", 0.0)
    said = f"waiting for tls/127.0.0.1:{port}: nobody answers there yet"
    own = parse_endpoint(f"tls/127.0.0.1:{port}", HOST, folder / "certs", insecure=False)
    with observing(plan, "a-run", signs.put):
        assert waits() and waits()
        with Session.listen([own], QUICK_PAYLOAD) as session:
            session.declare_alive(Keys("a-run", plan.description.shared_digest()).alive(HOST))
            until(Link(up=True), Token(HOST, alive=True))
        between = until(Link(up=False), Token(HOST, alive=False))
        assert not [sign for sign in between if said in str(sign)]
        while not waits():  # the env host has gone
            pass


def test_a_learner_of_another_seed_is_told_at_once_and_from_time_to_time(
    plan: Plan, folder: Path, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(observer, "REPORT_EVERY", 0.0)
    monkeypatch.setattr(observer, "_PATIENCE", 1.0)  # somebody is there already
    own = parse_endpoint(f"tls/127.0.0.1:{port}", HOST, folder / "certs", insecure=False)
    said = (
        f"waiting for tls/127.0.0.1:{port}: no env host of run '3agent_hopper-seed1' is there;"
        " does it run this very description (its name, --set and --seed)?"
    )
    signs: queue.SimpleQueue[Sign | Waiting] = queue.SimpleQueue()
    with Session.listen([own], QUICK_PAYLOAD) as session:
        digest = plan.description.shared_digest()
        session.declare_alive(Keys("3agent_hopper-seed0", digest).alive(HOST))
        assert nobody_of_run(plan, "3agent_hopper-seed0") == ""
        assert nobody_of_run(plan, "3agent_hopper-seed1") == said
        with observing(plan, "3agent_hopper-seed1", signs.put):
            found = [signs.get(timeout=PATIENCE) for _ in range(4)]
    assert found.count(Waiting(said)) == 3 and Link(up=True) in found
