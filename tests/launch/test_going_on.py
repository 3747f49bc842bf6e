"""A run that is extended, and one that begins with the policies of another."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.description import Description
from otc_dist.launch.__main__ import main
from otc_dist.launch.plan.run_record import RunRecord
from otc_dist.learner import checkpoint
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError

from .conftest import AGENTS, Launcher, same

Launch = Callable[..., Launcher]


def copied(finished: tuple[RunFolder, Launcher], tmp_path: Path) -> RunFolder:
    """The finished run of two deployments, to be spoilt."""
    return RunFolder(shutil.copytree(finished[0].root, tmp_path / "copy"))


def settle(folder: RunFolder, *assignments: str) -> None:
    """Give a run another description, as if it had been begun with it."""
    description = Description.load(folder.description, assignments)
    folder.description.write_text(description.to_toml())
    record = json.loads(folder.run_json.read_text())
    folder.run_json.write_text(json.dumps(record | {"description": description.digest()}))


def refusal(*arguments: str) -> str:
    with pytest.raises(UserError) as refused:
        main([*arguments])
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.slow
def test_a_finished_run_that_is_extended_ends_as_if_it_had_been_longer_from_the_start(
    finished: tuple[RunFolder, Launcher],
    launch: Launch,
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
) -> None:
    short = ("--set", "deployment.count=1")
    launcher = launch("3agent_hopper", *tiny_flags, *short, "--out", "run")
    assert launcher.finish() == 0, launcher.text
    folder = RunFolder(tmp_path / "run")
    first = folder.checkpoint("agent_0", 1).stat().st_mtime_ns
    assert "has made 1 deployments already" in refusal(
        "--resume", str(folder.root), "--deployments", "1"
    )
    assert "is finished; see" in refusal("--resume", str(folder.root))

    extended = launch("--resume", str(folder.root), "--deployments", "2")
    assert extended.finish() == 0, extended.text
    same(folder, finished[0])
    assert folder.checkpoint("agent_0", 1).stat().st_mtime_ns == first
    assert RunRecord.read(folder).extended == (2,)
    assert json.loads(folder.results.read_text())["complete"]
    assert "extended to deployments" in folder.report.read_text()
    for agent in AGENTS:
        own, whole = folder.recommended(agent), finished[0].recommended(agent)
        assert own.read_text() == whole.read_text()


@pytest.mark.slow
def test_an_extension_that_was_cut_off_is_asked_for_again(
    finished: tuple[RunFolder, Launcher], launch: Launch, tmp_path: Path
) -> None:
    """run.json tells already of what description.toml does not say yet."""
    folder = copied(finished, tmp_path)
    record = RunRecord.read(folder)
    longer = Description.load(folder.description, ["deployment.count=3"])
    changed = json.loads(folder.run_json.read_text()) | {"description": longer.digest()}
    folder.run_json.write_text(json.dumps({**changed, "state": "stopped"}))
    assert "has changed since the run began" in refusal("--resume", str(folder.root))
    extended = launch("--resume", str(folder.root), "--deployments", "3")
    assert extended.finish() == 0, extended.text
    assert folder.checkpoint("agent_0", 3).exists() and RunRecord.read(folder).run == record.run


@pytest.mark.slow
@pytest.mark.parametrize(
    ("assignments", "deployments", "said"),
    [
        ((), "2", "has made 2 deployments already: --deployments must be more"),
        ((), "1", "has made 2 deployments already: --deployments must be more"),
        (("sampling.name=balanced",), "3", "sampling.name = 'balanced' keeps priorities"),
        (("env.id=navigation",), "3", "navigation changes in the course of the deployments"),
        (("deployment.floor=1e6",), "3", "below deployment.floor = 1e+06"),
    ],
)
def test_what_cannot_be_extended_is_one_line_and_stays_as_it_is(
    finished: tuple[RunFolder, Launcher],
    tmp_path: Path,
    assignments: tuple[str, ...],
    deployments: str,
    said: str,
) -> None:
    folder = copied(finished, tmp_path)
    if assignments:
        settle(folder, *assignments)
    before = folder.run_json.read_text()
    assert said in refusal("--resume", str(folder.root), "--deployments", deployments)
    assert folder.run_json.read_text() == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("3agent_hopper", "--deployments", "3"), "--deployments extends a run: with --resume"),
        (("3agent_hopper", "--from", "nowhere"), "nowhere is not a run folder"),
        (
            ("3agent_hopper", "--from", "x", "--role", "host", "--listen", "tls/0.0.0.0:1"),
            "--from is for a run whose processes are all on one machine",
        ),
        (("--resume", "x", "--from", "y"), "leave out --from"),
    ],
)
def test_flags_in_the_wrong_place_are_one_line(arguments: tuple[str, ...], said: str) -> None:
    assert said in refusal(*arguments)


def begun(flags: tuple[str, ...]) -> tuple[str, ...]:
    """These flags without what is refused beside --from."""
    values = (value for value in flags[1::2] if not value.startswith("offline."))
    return tuple(word for value in values for word in ("--set", value))


@pytest.mark.slow
def test_a_run_begins_with_the_policies_of_another_and_trains_none(
    finished: tuple[RunFolder, Launcher],
    launch: Launch,
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
) -> None:
    source = finished[0]
    other = ("--seed", "7", "--set", "dataset.name=hopper-3x1/random", "--from", str(source.root))
    launcher = launch("3agent_hopper", *begun(tiny_flags), *other, "--out", "run")
    assert launcher.finish() == 0, launcher.text
    folder = RunFolder(tmp_path / "run")
    for agent in AGENTS:
        assert f"{agent}: offline" not in launcher.text
        taken, told = checkpoint.read(folder.checkpoint(agent, 0))
        given, _ = checkpoint.read(source.checkpoint(agent, 0))
        assert checkpoint.digest(taken) == checkpoint.digest(given)  # and what the distance fitted
        assert told.tuned == 0
    first = json.loads(folder.evaluation(0).read_text())["policies"]
    assert first == json.loads(finished[0].evaluation(0).read_text())["policies"]
    assert RunRecord.read(folder).origin == str(source.root)
    assert json.loads(folder.results.read_text())["pi_0"] == str(source.root)
    assert str(source.root) in folder.report.read_text()

    shutil.rmtree(folder.agent("agent_1"))
    settle(folder)
    record = json.loads(folder.run_json.read_text())
    folder.run_json.write_text(json.dumps(record | {"state": "stopped"}))
    resumed = launch("--resume", str(folder.root))
    assert resumed.finish() == 2
    assert "this run did not train it but took it from another one" in resumed.text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("2agent_halfcheetah",), "is of other agents: agent_0 with observations of 11 and"),
        (("1agent_hopper",), "is of other agents"),
        (("3agent_hopper", "--set", "algorithm.name=bcq"), "another algorithm: algorithm.name"),
        (
            ("3agent_hopper", "--set", "algorithm.batch_size=31"),
            "another algorithm: algorithm.batch_size = 32 is not this description's",
        ),
    ],
)
def test_policies_of_other_agents_are_refused_in_one_line(
    finished: tuple[RunFolder, Launcher],
    tiny_flags: tuple[str, ...],
    arguments: tuple[str, ...],
    said: str,
) -> None:
    name, *rest = arguments
    assert said in refusal(
        name, *begun(tiny_flags), *rest, "--from", str(finished[0].root), "--dry-run"
    )


@pytest.mark.slow
def test_a_distance_that_was_fitted_otherwise_is_fitted_anew(
    finished: tuple[RunFolder, Launcher],
    launch: Launch,
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
) -> None:
    """The policies are a comparison's, where a seed's agents lie in a folder of its own."""
    source = RunFolder(tmp_path / "compared" / "seeds" / "seed_00")
    shutil.copytree(finished[0].root / "agents", source.root / "agents")
    shutil.copy(finished[0].description, tmp_path / "compared" / "description.toml")
    other = ("--set", "dynamics.hidden=[16]", "--set", "deployment.count=1")
    launcher = launch(
        *("3agent_hopper", *begun(tiny_flags), *other),
        *("--from", str(source.root), "--out", "run"),
    )
    assert launcher.finish() == 0, launcher.text
    assert "agent_0: dynamics" in launcher.text and "agent_0: offline" not in launcher.text
    folder = RunFolder(tmp_path / "run")
    policies = json.loads(folder.evaluation(0).read_text())["policies"]
    assert policies == json.loads(finished[0].evaluation(0).read_text())["policies"]
    assert RunRecord.read(folder).origin == str(source.root)
    assert json.loads(folder.results.read_text())["pi_0"] == str(source.root)
    assert str(source.root) in folder.report.read_text()
