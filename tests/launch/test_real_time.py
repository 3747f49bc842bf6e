"""Devices that do not wait, by the launcher: what a person is asked, stops and goes on with."""

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from otc_dist.deployment_log.arrays import read_log
from otc_dist.launch.__main__ import main
from otc_dist.launch.plan import descriptions
from otc_dist.replay.__main__ import main as replay
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError

from .. import carts
from .conftest import Launcher
from .scrapes import free_port, scraped

REAL_TIME = ("deployment.rate_hz=50", "env.copies=1", "evaluation.episodes=0")


@pytest.fixture(scope="module", autouse=True)
def robots() -> Iterator[None]:
    with carts.found():
        yield


@pytest.mark.slow
def test_a_person_resets_the_devices_stops_the_run_and_goes_on(
    launch: Callable[..., Launcher],
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("CARTS_TOLD", str(tmp_path / "told"))
    monkeypatch.setenv("CARTS_PERIOD", "0.1")  # a busy machine answers within that
    folder = RunFolder(tmp_path / "run")
    own = (f"env.id={carts.ENV}", "dataset.name=recorded", "sampling.name=uniform")
    short = ("deployment.transitions=30", "deployment.count=1", "deployment.rate_hz=10")
    asked = (*own, *REAL_TIME, *short, "deployment.reset_by_hand=true")
    flags = [flag for text in asked for flag in ("--set", text)]
    launcher = launch("navigation", *tiny_flags, *flags, "--out", "run")
    waits = "waits for a person to reset the devices, in deployment 1, step 0"
    launcher.read_until(lambda line: line.startswith(waits))
    folder.stop.touch()
    assert launcher.finish() == 3, launcher.text
    assert launcher.lines[-1].startswith(f"stopped: a person made {folder.stop}; resume with: ")
    assert not (tmp_path / "told").exists()
    assert main(["status", str(folder.root)]) == 0
    assert capsys.readouterr().out.startswith(f"{folder.root}: stopped")

    port, told = free_port(), set()

    def finished(line: str) -> bool:
        """Approve whatever is asked for until the run is over."""
        with suppress(OSError):  # before the env host answers, and when it is done
            told.update(kind for name, kind in scraped(port) if name == "otc_missed")
        if line.startswith("approve with: "):
            assert main(["approve", str(folder.root)]) == 0
        return line.endswith(": finished")

    again = launch("--resume", "run", "--prometheus", str(port))
    again.read_until(finished)
    assert "approved: deployment 1, from step 0 on, by policy 0" in capsys.readouterr().out
    assert told == {"held", "late", "broken_off"}
    assert again.finish() == 0 and any(line.startswith(waits) for line in again.lines)
    path = folder.deployment(1)
    log = read_log(path)
    assert log.partial is None and len(log) == 30 and not log.held["left"].all()
    assert json.loads(folder.results.read_text())["complete"]
    assert replay([str(path), "--verify"]) == 0
    assert capsys.readouterr().out.count("computed again") == 2


@pytest.mark.parametrize(
    ("assignments", "said"),
    [
        (("deployment.rate_hz=0",), "deployment.rate_hz: input should be greater than 0"),
        (REAL_TIME[:1], "deployment.rate_hz needs env.copies = 1"),
        (REAL_TIME[:2], "deployment.rate_hz needs evaluation.episodes = 0"),
        (("deployment.reset_by_hand=true",), "reset_by_hand needs rate_hz"),
        (
            (*REAL_TIME, f"env.id={carts.ENV}", "dataset.name=random"),
            "would play the devices at random",
        ),
    ],
)
def test_what_cannot_be_done_in_real_time_is_one_line(
    assignments: tuple[str, ...], said: str
) -> None:
    with pytest.raises(UserError) as refused:
        descriptions.load("navigation", assignments, None, quick=False)
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_a_description_without_a_clock_is_the_one_of_before() -> None:
    """So are its digests, by which runs that were begun before there was a clock go on."""
    plain = descriptions.load("navigation", (), None, quick=False)
    assert not {"rate_hz", "reset_by_hand"} & plain.deployment.model_dump(mode="json").keys()
    timed = descriptions.load("navigation", REAL_TIME, None, quick=False)
    by_hand = timed.with_assignments("deployment.reset_by_hand=true")
    assert by_hand.deployment.rate_hz == 50
    assert timed.tuning_digest() == by_hand.tuning_digest()  # who resets them changes no step
    slower = timed.with_assignments("deployment.rate_hz=20")
    assert timed.tuning_digest() != slower.tuning_digest()


def test_a_dry_run_tells_of_the_clock(capsys: pytest.CaptureFixture[str]) -> None:
    asked = (*REAL_TIME, "deployment.reset_by_hand=true")
    flags = [flag for text in asked for flag in ("--set", text)]
    assert main(["3agent_hopper", "--quick", "--dry-run", *flags]) == 0
    said = capsys.readouterr().out
    assert "50 steps a second: who answers later repeats its action" in said
    assert "a person resets the devices before each episode" in said
