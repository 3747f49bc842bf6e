"""One form for every name, wherever one enters."""

from pathlib import Path

import pytest

from otc_dist import names
from otc_dist.certs.__main__ import main as certs
from otc_dist.comparison.arms import parse_arms
from otc_dist.datasets.importers import import_files
from otc_dist.datasets.names import DatasetName
from otc_dist.launch.run.command import main as launch
from otc_dist.terminal.errors import UserError

BAD = ("", ".", "..", "../x", "/x", "a/b", "-x", ".x", "a b", "a\nb", "a\0b", "é", "x" * 129, "a:b")
GOOD = ("a", "agent_0", "3agent_hopper", "x" * 128, "a.b", "a-b", "_a", "0", "a..b")


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_name(name: str) -> None:
    assert not names.is_name(name)
    with pytest.raises(ValueError, match="is not a valid name"):
        names.checked(name)
    assert names.is_name(names.from_text(name))


def test_names() -> None:
    assert all(map(names.is_name, GOOD)) and [names.checked(name) for name in GOOD] == list(GOOD)
    assert all(names.from_text(name) == name for name in GOOD)


@pytest.mark.parametrize("name", sorted(names.RESERVED | {"Host"}))
def test_no_agent_has_a_name_that_stands_for_something_else(name: str) -> None:
    with pytest.raises(ValueError, match="stands for something else"):
        names.check_agents(["agent_0", name])


@pytest.mark.parametrize("env_id", ["a", "smax/3m", "pkg.module:make", "hopper-3x1"])
def test_environments(env_id: str) -> None:
    assert names.checked_environment(env_id) == env_id
    assert names.checked_dataset(f"{env_id}/medium") == f"{env_id}/medium"


@pytest.mark.parametrize("env_id", [*BAD[:5], *BAD[6:-1], "a/b/c", "../x:y", "a:b:c", "a/../b"])
def test_no_environments(env_id: str) -> None:
    with pytest.raises(ValueError, match="is not a valid environment id"):
        names.checked_environment(env_id)


@pytest.mark.parametrize(
    "assignment",
    [
        "name=../../x", "name=/tmp/x", "name=''", "name=-x", "name='a\\nb'", "env.id=../../x",
        "env.id=/tmp/x", "dataset.name=../../x", "dataset.name=/abs", "dataset.name=a/../../b",
    ],
)  # fmt: skip
def test_a_description_with_a_bad_name_is_one_line_and_leaves_nothing(
    assignment: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "inside").mkdir()
    monkeypatch.chdir(tmp_path / "inside")
    with pytest.raises(UserError) as caught:
        launch(["navigation", "--dry-run", "--set", assignment])
    line = str(caught.value)
    assert line.startswith("command line: ") and line.isprintable() and assignment[:3] in line
    assert [path.name for path in tmp_path.rglob("*")] == ["inside"]


@pytest.mark.parametrize("text", ["x = " + "[" * 10_000, "x = " + "9" * 5000, "x = [1", "\0"])
def test_a_description_that_no_parser_likes_is_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=f"{path} is not valid TOML") as caught:
        launch([str(path), "--dry-run"])
    assert str(caught.value).isprintable()


def test_data_sets_arms_and_runs(tmp_path: Path) -> None:
    with pytest.raises(UserError):
        DatasetName.parse("hopper-3x1/..")
    with pytest.raises(UserError, match="write name=section"):
        parse_arms("uniform", ["../x=sampling.alpha=1"])
    with pytest.raises(UserError, match="is not a valid run name"):
        certs([str(tmp_path / "certs"), "--agents", "2", "--rules", "../x"])
    source = tmp_path / "a.hdf5"
    source.write_bytes(b"")
    with pytest.raises(UserError, match="a data set cannot have this name"):
        import_files([source], "../x", "hopper-3x1")
