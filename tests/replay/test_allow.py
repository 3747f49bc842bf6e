"""Reading runs no code that a file names, whatever is asked, until it is allowed by name."""

from dataclasses import replace
from pathlib import Path

import pytest
from safetensors.numpy import load_file, save_file

from otc_dist.datasets.__main__ import main as datasets
from otc_dist.datasets.agent_files import read_file
from otc_dist.deployment_log.reader import read_header, read_steps
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.description import user_code
from otc_dist.launch.run.command import main as launch
from otc_dist.replay.__main__ import main as replay
from otc_dist.terminal.errors import UserError

from .deployments import described, played

CODE = """
from pathlib import Path
Path(__file__).with_suffix(".ran").touch()
from mpe2 import simple_spread_v3

def parallel_env():
    Path(__file__).with_suffix(".called").touch()
    return simple_spread_v3.parallel_env(N=2, continuous_actions=True)
"""
READERS = {
    "summary": (),
    "steps": ("--steps", "0:2"),
    "verify": ("--verify",),
    "recover": ("--recover", "--out", "{}/whole.mcap"),
    "html": ("--html", "{}/page.html"),
    "sheet": ("--sheet", "{}/sheet.png"),
    "foxglove": ("--foxglove", "{}/fox.mcap"),
    **{
        form: ("--export", form, "--out", "{}/out")
        for form in ("csv", "parquet", "minari", "d4rl", "lerobot")
    },
}
NEEDS_IT = {"verify"}


class Foreign:
    """A module that leaves a mark where it is imported or called, and a log that names it."""

    def __init__(self, folder: Path) -> None:
        self.folder, name = folder, f"foreign_{folder.name}"
        self.module, self.reference = folder / f"{name}.py", f"{name}:parallel_env"
        self.module.write_text(CODE)

    @property
    def ran(self) -> bool:
        return any(self.module.with_suffix(end).exists() for end in (".ran", ".called"))


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Foreign:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(user_code, "_allowed", set())
    return Foreign(tmp_path)


@pytest.fixture(scope="module")
def innocent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short log of two agents of the right sizes, which really are particles."""
    return played(tmp_path_factory.mktemp("innocent") / "log.mcap", "cooperative-navigation-2", 4)


@pytest.fixture
def log(foreign: Foreign, innocent: Path) -> Path:
    """The log, which says of itself that it was played in the foreign code."""
    header = read_header(innocent)
    described_by = header.description.replace(header.team.env_id, foreign.reference)
    path = foreign.folder / "run" / "deployments" / "deployment_02.mcap"
    told = replace(
        header,
        team=replace(header.team, env_id=foreign.reference),
        description=described_by,
    )
    writer = LogWriter.create(path, told)
    for step in read_steps(innocent):
        writer.write(step)
    return writer.finish(dict.fromkeys(header.team.names, "0" * 16))


@pytest.mark.parametrize("reader", READERS)
def test_no_reader_of_a_log_runs_what_it_names(foreign: Foreign, log: Path, reader: str) -> None:
    arguments = [str(log), *(part.format(foreign.folder) for part in READERS[reader])]
    try:
        replay(arguments)
        refused = ""
    except UserError as error:
        refused = str(error)
    assert not foreign.ran
    if reader in NEEDS_IT:
        assert f"--allow {foreign.reference}" in refused and "\n" not in refused
        with pytest.raises(UserError):
            replay([*arguments, "--allow", "another:thing"])
        assert not foreign.ran
        with pytest.raises(UserError, match="was played in another"):  # but it has been looked at
            replay([*arguments, "--allow", foreign.reference])
        assert foreign.ran


def test_an_import_of_a_log_runs_it_only_if_allowed(foreign: Foreign, log: Path) -> None:
    arguments = ["import", str(log), "--name", "theirs"]
    with pytest.raises(UserError, match=f"{log}: .*--allow {foreign.reference}"):
        datasets(arguments)
    assert not foreign.ran
    with pytest.raises(UserError, match="had other agents when it was recorded"):
        datasets([*arguments, "--allow", foreign.reference])
    assert foreign.ran


def test_a_name_on_the_command_line_allows_what_it_names(foreign: Foreign) -> None:
    assert datasets(["make", f"{foreign.reference}/random", "--transitions", "30"]) == 0
    assert foreign.ran


def test_one_agents_file_and_the_cache_run_nothing(
    foreign: Foreign, cache_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    datasets(["make", "cooperative-navigation-2/random", "--transitions", "30"])
    folder = cache_folder / "datasets/cooperative-navigation-2/random/30"
    file = folder / "agent_0.safetensors"
    about = {"dataset": f"{foreign.reference}/theirs", "env_id": foreign.reference}
    own = foreign.folder / "agent_0.safetensors"
    save_file(load_file(file), own, metadata={"otc_dist": _with(file, **about)})
    cached = cache_folder / "datasets" / foreign.reference / "random/30"
    cached.mkdir(parents=True)
    (cached / own.name).write_bytes(own.read_bytes())
    with pytest.raises(UserError, match=f"{own}: .*--allow {foreign.reference}"):
        datasets(["import", str(own)])
    datasets(["list"])
    assert foreign.reference in capsys.readouterr().out
    assert not foreign.ran


def test_the_run_whose_policies_are_taken_runs_nothing(foreign: Foreign) -> None:
    run = foreign.folder / "run"
    run.mkdir()
    text = described("cooperative-navigation-2", 4, 2).to_toml()
    text = text.replace("cooperative-navigation-2", foreign.reference)
    (run / "description.toml").write_text(text)
    with pytest.raises(UserError, match=f"{run}: .*--allow {foreign.reference}"):
        launch(["navigation", "--from", str(run), "--dry-run"])
    assert not foreign.ran
    with pytest.raises(UserError, match="is of other agents"):
        launch(["navigation", "--from", str(run), "--dry-run", "--allow", foreign.reference])
    assert foreign.ran
    with pytest.raises(UserError, match="--allow is for --from"):
        launch(["navigation", "--dry-run", "--allow", foreign.reference])


def test_no_folder_for_learners_is_made_of_a_log_that_names_code(
    foreign: Foreign, log: Path
) -> None:
    whole = log.with_name("deployment_01.mcap")  # the first is needed, too
    header = read_header(log)
    writer = LogWriter.create(whole, replace(header, deployment=1))
    for step in read_steps(log):
        writer.write(step)
    writer.finish(dict.fromkeys(header.team.names, "0" * 16))
    folder = foreign.folder / "again"
    words = (str(whole), str(log), "--publish", "--learners", "--run", str(folder))
    with pytest.raises(UserError, match=f"--allow {foreign.reference}"):
        replay([*words])
    assert not foreign.ran and not (folder / "description.toml").exists()


def _with(path: Path, **fields: str) -> str:
    """The header of an agent's file with other fields, and its checksum made anew."""
    header, tensors = read_file(path)
    return header.model_copy(update=fields).sealed(tensors).model_dump_json()


@pytest.mark.parametrize("text", ["module", "a:b:c", "os:system('x')", "../a:b", ""])
def test_a_flag_that_names_no_code_is_one_line(text: str) -> None:
    for main in (replay, datasets):
        words = ["x.mcap"] if main is replay else ["import", "x.mcap"]
        with pytest.raises(UserError, match="form module:function"):
            main([*words, "--allow", text])
