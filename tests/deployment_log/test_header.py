"""Whatever a header says, in whatever type: it is what it must be, or one line says what is not."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from otc_dist.deployment_log import finishing
from otc_dist.deployment_log.format import DamagedLogError
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.salvage import Salvage
from otc_dist.replay.__main__ import main
from otc_dist.terminal.errors import UserError
from tests.deployment_log.conftest import Recording

Entries = dict[str, str]
# What may stand where something else belongs, as JSON.
ODD = (
    "null", "true", "-1", "0", "1.5", "1e400", "NaN", str(10**12), str(10**30), '"x"', '""',
    '"../../x"', '"/etc/x"', '"a\\u0000b"', '"\\u001b[31mred"', '"-f"', '".x"', '"host"',
    json.dumps("x" * 5000), "[]", "[[[1]]]", "{}", '{"a": {"b": [null]}}', "[" * 100_000, "{",
)  # fmt: skip


NAMES = {"null", "true", "NaN", "0", "1.5", "1e400", str(10**12), str(10**30), '"x"', '"host"'}
# Which of ODD a field may be; all others are refused.
HEADER: dict[str, set[str]] = {
    "format_version": set(),
    "run": NAMES,
    "deployment": set(),
    "seed": {"0", str(10**12)},
    "copies": set(),
    "team": set(),
    "versions": {"{}"},
    "description": set(ODD),
    "description_digest": {"0", "1e400", str(10**12), str(10**30), '""'},
}
TEAM: dict[str, set[str]] = {
    "env_id": {'"x"', '"host"'},
    "agents": set(),
    "state_size": {"0"},
    "max_episode_steps": set(),
}
AGENT: dict[str, set[str]] = {
    "name": {'"x"'},
    "observation_size": set(),
    "action_low": set(),
    "action_high": set(),
    "choices": {"0"},
}
PLACES = {
    **{f"header.{field}": right for field, right in HEADER.items()},
    **{f"team.{field}": right for field, right in TEAM.items()},
    **{f"agent.{field}": right for field, right in AGENT.items()},
}


def entries() -> Entries:
    return Recording(((3, 1), (2, 2)), copies=2, steps=0).header.to_entries()


def placed(entries: Entries, place: str, text: str) -> Entries:
    """The entries with other JSON at `place`."""
    kind, _, field = place.partition(".")
    if kind == "header":
        try:
            plain = json.loads(text)
        except (ValueError, RecursionError):
            plain = text
        return {**entries, field: plain if isinstance(plain, str) else text}
    team = json.loads(entries["team"])
    (team if kind == "team" else team["agents"][1])[field] = "HERE"
    return {**entries, "team": json.dumps(team).replace('"HERE"', text)}


@pytest.mark.parametrize("place", PLACES)
def test_a_field_of_another_type_is_one_line_that_names_it(place: str) -> None:
    for text in ODD:
        try:
            LogHeader.from_entries(placed(entries(), place, text), Path("a.mcap"))
        except UserError as error:
            line = str(error)
            assert line.startswith("a.mcap") and line.isprintable() and len(line) < 600
            assert text not in PLACES[place]
        else:
            assert text in PLACES[place]


@pytest.mark.parametrize("field", HEADER)
def test_a_field_that_is_missing_is_named(field: str) -> None:
    left = {name: text for name, text in entries().items() if name != field}
    with pytest.raises(UserError, match=f"^a.mcap: its header .*{field}"):
        LogHeader.from_entries(left, Path("a.mcap"))


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("agent_0", "agent_0"), "two agents are called 'agent_0'"),
        (("a", "A"), "two agents are called 'A'"),
        (("a", "joint"), "an agent cannot be called 'joint'"),
        (("a", "../b"), "'../b' is not a valid name"),
        (("a", "b" * 129), "is not a valid name"),
    ],
)
def test_names_that_will_not_do(names: tuple[str, str], said: str) -> None:
    changed = entries()
    team = json.loads(changed["team"])
    for agent, name in zip(team["agents"], names, strict=True):
        agent["name"] = name
    changed["team"] = json.dumps(team)
    with pytest.raises(UserError, match=f"a.mcap: its header is not valid: .*{said}"):
        LogHeader.from_entries(changed, Path("a.mcap"))


def forged(path: Path, made: Recording, place: str, text: str) -> Path:
    """A finished log whose header, with a good checksum, says something else."""
    changed = placed(made.header.to_entries(), place, text)
    ours = made.header
    header = SimpleNamespace(**vars(ours), binding=ours.binding, layout=ours.layout)
    header.to_entries = lambda: changed
    with OpenLog(made.write(path.with_name("whole.mcap")).finish({})) as log:
        finishing.write_finished(path, header, log.blocks, {})  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize(
    ("place", "text"),
    [("header.copies", str(10**8)), ("team.state_size", str(10**9)), ("agent.name", '"../../x"')],
)
@pytest.mark.parametrize("read", [OpenLog, Salvage])
def test_every_reader_says_it(
    tmp_path: Path, small: Recording, read: type, place: str, text: str
) -> None:
    path = forged(tmp_path / "log.mcap", small, place, text)
    with pytest.raises(UserError, match=f"{path.name}") as caught:
        read(path)
    assert not isinstance(caught.value, DamagedLogError)


@pytest.mark.parametrize("table", ["", "null", "{}", "[[]]", '[{"copy": 0}]', "[" * 100_000])
def test_a_table_of_episodes_that_is_none(
    tmp_path: Path, small: Recording, monkeypatch: pytest.MonkeyPatch, table: str
) -> None:
    monkeypatch.setattr(finishing, "to_json", lambda _: table)
    path = small.finish(tmp_path / "log.mcap")
    with pytest.raises(UserError, match="its table of episodes"):
        main([str(path)])
