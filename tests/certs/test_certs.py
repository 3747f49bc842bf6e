"""Certificates are made, kept and guarded; a mistake is one line."""

import os
import shutil
import stat
from pathlib import Path

import pytest

from otc_dist.bus.identity import CERTIFICATE, KEY
from otc_dist.bus.keys import HOST, OBSERVER
from otc_dist.certs import authority
from otc_dist.certs.__main__ import main as certs
from otc_dist.terminal.errors import UserError

AGENTS = ("agent_0", "agent_1")


def refusal(folder: Path, *words: str) -> str:
    with pytest.raises(UserError) as refused:
        certs([str(folder), *words])
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_making_certificates_again_keeps_the_good_ones(tmp_path: Path) -> None:
    def made(agents: tuple[str, ...], names: tuple[str, ...]) -> list[str]:
        lines = authority.make(folder, agents, names, 30)
        return [line.rpartition("/")[2].split(",")[0] for line in lines]

    folder, names = tmp_path / "certs", ("a.example.org", "192.0.2.1")
    assert made(AGENTS, names) == [f"{process}: made" for process in (HOST, *AGENTS, OBSERVER)]
    (folder / "agent_0" / KEY).unlink()
    assert made((*AGENTS, "agent_2"), (*names, "b.example.org")) == [
        "host: made",  # it is reached by another name, too
        "agent_0: made",
        "agent_1: kept",
        "agent_2: made",
        "observer: kept",
    ]
    for key in folder.glob("*/key.pem"):
        assert stat.S_IMODE(key.stat().st_mode) == 0o600
        assert stat.S_IMODE(key.parent.stat().st_mode) == 0o700


def test_nobody_else_gets_at_certificates_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        list(authority.make(tmp_path / "new" / "certs", AGENTS, ["a.example.org"], 30))
        (tmp_path / "open").mkdir()
    finally:
        os.umask(before)
    for folder, _, _ in os.walk(tmp_path / "new" / "certs"):
        assert stat.S_IMODE(Path(folder).stat().st_mode) == 0o700, folder
    refused = refusal(tmp_path / "open", "--agents", "1")
    assert "others can write in" in refused
    assert list((tmp_path / "open").iterdir()) == []


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["--agents", "0"], "must be 1 or more"),
        (["--agents", "1", "--host", "\u00e9 no name"], "is not a host name or an IP address"),
        (["--agents", "1", "--host", "a b"], "--host 'a b' is not a host name"),
        (["--agents", "1", "--host", ""], "--host '' is not a host name"),
        (["--agents", "1", "--days", "0"], "must be 1 or more"),
        (
            ["--agents", "1", "--rules", "run", "--host", "A"],
            "--rules makes no certificates: leave",
        ),
    ],
)
def test_mistakes_with_certs_are_one_line(argv: list[str], says: str, tmp_path: Path) -> None:
    assert says in refusal(tmp_path / "certs", *argv)
    assert list(tmp_path.iterdir()) == []


def test_a_learner_s_certificate_from_elsewhere_is_not_replaced(tmp_path: Path) -> None:
    """On its host it lies alone (`scp -r certs/agent_1 B:certs/`), as in `docs/hosts.md`."""
    here, there = tmp_path / "A", tmp_path / "B"
    list(authority.make(here, AGENTS, ["a.example.org"], 30))
    there.mkdir(mode=0o700)
    shutil.copytree(here / "agent_1", there / "agent_1")
    before = {path: path.read_bytes() for path in there.rglob("*.pem")}
    for _ in ("no authority", "another one"):
        assert f"{there / 'agent_1'} was made by an auth" in refusal(there, "--agents", "2")
        assert {path: path.read_bytes() for path in there.glob("agent_1/*.pem")} == before
        assert not (there / "agent_0").exists()
        list(authority.make(there, (), ["b.example.org"], 30))


@pytest.mark.parametrize("beside", ["run.json", "inputs.json", "seeds"])
@pytest.mark.parametrize("below", ["", "certs", "output/certs"])
def test_a_run_s_folder_gets_no_keys(tmp_path: Path, beside: str, below: str) -> None:
    for name in ("description.toml", beside):
        (tmp_path / name).touch()
    said = refusal(tmp_path / below, "--agents", "1")
    assert said.startswith(f"{tmp_path} is the folder of a run or a comparison")
    assert len([*tmp_path.iterdir()]) == 2


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "authority").mkdir()
    (tmp_path / "authority" / CERTIFICATE).write_text("mine")
    assert "delete" in refusal(tmp_path, "--agents", "1")
    assert (tmp_path / "authority" / CERTIFICATE).read_text() == "mine"
