"""Deployment logs become agents' files: each agent's own transitions, as they were logged."""

from contextlib import closing
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from otc_dist.datasets import store
from otc_dist.datasets.agent_files import load_tensors
from otc_dist.datasets.importers import import_files
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.reader import read_summary
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs import registry
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import JointStep, Transitions
from tests.power_cut import Disk
from tests.replay.played import play

RUN = "hopper-run-1a2b3c"
NAME = f"hopper-3x1/{RUN}"
AGENTS = ("agent_0", "agent_1", "agent_2")
Deployments = tuple[list[Path], list[JointStep]]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def deployments(tmp_path_factory: pytest.TempPathFactory) -> Deployments:
    """Two deployments of one run, and the steps of both."""
    folder = tmp_path_factory.mktemp("deployments")
    paths, steps = [], []
    for k in (1, 2):
        paths.append(folder / f"deployment_{k:02d}.mcap")
        steps += play("hopper-3x1", paths[-1], 300, 2, run=RUN, deployment=k)
    return paths, steps


def of_agent(steps: list[JointStep], index: int) -> Transitions:
    return Transitions.concatenate([step.of_agent(index) for step in steps])


def check(name: str, steps: list[JointStep]) -> None:
    """Each agent's file holds its part of the steps, and nothing else."""
    for index, agent in enumerate(AGENTS):
        tensors = dict(load_tensors(store.agent_file(name, agent), agent))
        assert len(tensors.pop("episodes")) == len(steps) * len(steps[0].terminated)
        expected = of_agent(steps, index)
        assert set(tensors) == {field.name for field in fields(expected)}
        for field, array in tensors.items():
            assert array.tobytes() == getattr(expected, field).tobytes()


def log(path: Path, steps: list[JointStep], **changes: object) -> Path:
    """A finished log of given steps of Hopper."""
    header = LogHeader(RUN, 1, 0, "", "", registry.team_spec("hopper-3x1"), len(steps[0].state))
    writer = LogWriter.create(path, replace(header, **changes))  # type: ignore[arg-type]
    for step in steps:
        writer.write(step)
    return writer.finish({})


def refusal(*sources: Path, name: str = "", env_id: str = "") -> str:
    with pytest.raises(UserError) as caught:
        import_files(sources, name, env_id)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_logs_of_a_run_become_one_set_with_the_runs_name(deployments: Deployments) -> None:
    paths, steps = deployments
    card = import_files(paths)
    assert (card.name, card.transitions, card.notes) == (NAME, 1200, ())
    assert list(card.recipe) == [f"{RUN} deployment 1", f"{RUN} deployment 2"]
    check(NAME, steps)
    assert store.ensure(NAME) == card


def test_their_episodes_and_returns_are_those_that_were_logged(deployments: Deployments) -> None:
    paths, _ = deployments
    card = import_files(paths)
    found = [
        (float(np.mean(episode.returns)), episode.terminated or episode.truncated)
        for path in paths
        for episode in read_summary(path).episodes
    ]
    whole = [returns for returns, ended in found if ended]
    assert (card.episodes, card.incomplete_episodes) == (len(whole), len(found) - len(whole))
    assert card.returns is not None
    assert card.returns.mean == pytest.approx(np.mean(whole))
    episodes = load_tensors(store.agent_file(NAME, "agent_0"), "agent_0")["episodes"]
    assert len(np.unique(episodes)) == len(found)


def test_a_power_cut_takes_nothing_of_a_set_that_was_made(
    deployments: Deployments, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = tmp_path / "cache"
    cache.mkdir()
    with closing(Disk(cache, monkeypatch)) as disk:
        import_files(deployments[0][:1])
        folder = f"datasets/{NAME}/600"
        files = [
            f"{folder}/{name}" for name in ("card.json", *(f"{a}.safetensors" for a in AGENTS))
        ]
        written = {name: (cache / name).read_bytes() for name in files}
        for state in disk.states():
            assert written == {name: state.get(name) for name in files}
        monkeypatch.undo()


def test_neither_order_nor_repetition_changes_anything(deployments: Deployments) -> None:
    paths, _ = deployments
    card = import_files(paths)
    assert import_files(paths[::-1]) == card
    assert "is there already" in refusal(paths[0])
    assert import_files(paths[:1], "first").transitions == 600


def test_of_an_unfinished_log_all_whole_steps_are_taken_and_it_is_said(
    deployments: Deployments, tmp_path: Path
) -> None:
    _, steps = deployments
    header = LogHeader(RUN, 1, 0, "", "", registry.team_spec("hopper-3x1"), 2)
    writer = LogWriter.create(tmp_path / "deployment_01.mcap", header)
    for step in steps[:100]:
        writer.write(step)
    writer.close()
    partial = tmp_path / "deployment_01.mcap.partial"
    partial.write_bytes(partial.read_bytes()[:-7])
    for source in (partial, tmp_path / "deployment_01.mcap"):  # found without its suffix, too
        card = import_files([source])
        assert card.notes == (
            "deployment_01.mcap.partial is unfinished: 99 steps, of how many is not known",
        )
        check(NAME, steps[:99])


def test_of_a_log_that_was_cut_the_whole_steps_are_taken(
    deployments: Deployments, tmp_path: Path
) -> None:
    paths, steps = deployments
    content = paths[0].read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: content.index(b"otc_dist.policies") // 2])
    card = import_files([cut])
    (note,) = card.notes
    taken = card.transitions // 2
    assert 0 < taken < 300
    assert note.startswith("cut.mcap is damaged") and note.endswith(
        f"{taken} steps in it are whole"
    )
    check(NAME, steps[:taken])


def test_what_lacks_its_beginning_does_not_count_as_an_episode(
    deployments: Deployments, tmp_path: Path
) -> None:
    """A step in the middle is damaged: two episodes, one of each copy, are cut in two."""
    _, steps = deployments
    header = LogHeader(RUN, 1, 0, "", "", registry.team_spec("hopper-3x1"), 2)
    writer = LogWriter.create(tmp_path / "a.mcap", header)
    for step in steps[:300]:
        writer.write(step)
    writer.close()
    partial = tmp_path / "a.mcap.partial"
    whole = import_files([partial], "whole")
    ends = [bool((step.terminated | step.truncated).any()) for step in steps[:300]]
    middle = next(t for t in range(1, 300) if not (ends[t - 1] or ends[t]))
    data = bytearray(partial.read_bytes())
    data[data.index(steps[middle].state.tobytes())] ^= 1
    partial.write_bytes(data)
    card = import_files([partial], "damaged")
    check("hopper-3x1/damaged", [*steps[:middle], *steps[middle + 1 : 300]])
    assert card.episodes == whole.episodes - 2
    assert card.incomplete_episodes == whole.incomplete_episodes + 4


def test_steps_that_did_not_happen_are_left_out(deployments: Deployments, tmp_path: Path) -> None:
    _, steps = deployments
    broke = replace(steps[1], terminated=np.ones(2, np.bool_), truncated=np.ones(2, np.bool_))
    card = import_files([log(tmp_path / "a.mcap", [steps[0], broke, *steps[2:5]])])
    assert card.notes == ("a.mcap: without 2 steps whose simulator broke off",)
    check(NAME, [steps[0], *steps[2:5]])


def test_logs_that_do_not_belong_together_are_refused(
    deployments: Deployments, tmp_path: Path
) -> None:
    paths, steps = deployments
    other = tmp_path / "other.mcap"
    play("navigation", other, 10, run="another")
    message = refusal(paths[0], other)
    assert "of hopper-3x1" in message and "of navigation" in message
    again = log(tmp_path / "again.mcap", steps[:3])
    assert "of the same deployment" in refusal(paths[0], again)
    elsewhere = log(tmp_path / "elsewhere.mcap", steps[:3], run="elsewhere")
    assert "name the result with --name" in refusal(paths[0], elsewhere)
    assert import_files([paths[0], elsewhere], "both").transitions == 606
    assert "was recorded in hopper-3x1, not in walker2d-2x3" in refusal(
        paths[0], env_id="walker2d-2x3"
    )


def test_a_log_of_an_environment_that_is_not_here_is_refused(
    deployments: Deployments, tmp_path: Path
) -> None:
    _, steps = deployments
    team = registry.team_spec("hopper-3x1")
    unknown = log(tmp_path / "a.mcap", steps[:3], team=replace(team, env_id="hopper-9x9"))
    assert "hopper-9x9, which this otc_dist does not have" in refusal(unknown)
    changed: TeamSpec = replace(team, env_id="hopper-1x3")
    assert "had other agents" in refusal(log(tmp_path / "b.mcap", steps[:3], team=changed))


def test_bad_values_and_what_is_no_log_are_refused(
    deployments: Deployments, tmp_path: Path
) -> None:
    paths, steps = deployments
    wrong = replace(steps[0], rewards=(np.full(2, np.nan, np.float32),) * 3)
    assert "agent_0: rewards has a value that is not finite" in refusal(
        log(tmp_path / "a.mcap", [wrong])
    )
    text = tmp_path / "text.mcap"
    text.write_text("hello")
    assert "is not an MCAP file" in refusal(text)
    assert "cannot be read" in refusal(tmp_path / "deployments" / "*.mcap")
    recording = tmp_path / "hopper.hdf5"
    assert "there is no " in refusal(recording)
    recording.touch()
    assert "import it alone" in refusal(paths[0], recording, name="x")
    assert "--name" in refusal(recording)
    assert "no whole step" in refusal(log_without_steps(tmp_path / "empty.mcap"))
    run = tmp_path / "run"
    (run / "deployments").mkdir(parents=True)
    (run / "run.json").touch()
    for folder in (run, run / "deployments"):
        assert f"{folder} is a folder; a run's logs are" in refusal(folder, name="x")


def log_without_steps(path: Path) -> Path:
    header = LogHeader(RUN, 1, 0, "", "", registry.team_spec("hopper-3x1"), 2)
    writer = LogWriter.create(path, header)
    writer.close()
    return path.with_name(path.name + ".partial")
