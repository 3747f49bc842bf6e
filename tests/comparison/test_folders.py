"""A folder that is none of this comparison: every command says so, also one that only looks."""

from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.launch.__main__ import main
from otc_dist.launch.plan import descriptions
from otc_dist.launch.run.resolve import resolve
from otc_dist.terminal.errors import UserError

PART = "3agent_hopper-medium-replay-one"
LOOK = ("--on", "slurm", "--status")


@pytest.fixture
def campaign(tmp_path: Path) -> list[str]:
    """A command that does the comparison `PART` in out/PART."""
    path = tmp_path / "one.toml"
    path.write_text('seeds = "0"\n[parts.one]\ndescriptions = ["3agent_hopper"]\n')
    return ["campaign", str(path), "--quick", "--out", str(tmp_path / "out")]


def refusal(words: list[str]) -> str:
    with pytest.raises(UserError) as raised:
        main(words)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def _description(text: str) -> str:
    other = resolve(descriptions.load("3agent_hopper", (), None, quick=True))
    return other.with_assignments(text).to_toml()


@pytest.mark.parametrize(
    ("file", "content", "expected"),
    [
        ("run.json", lambda: "{}", "is the folder of a run, not of a comparison; use another"),
        ("seed_00/uniform.json", lambda: "{}", "holds kept raw scores; use another --out"),
        ("thesis.tex", lambda: "", "holds something else; use another --out"),
        ("description.toml", lambda: _description("offline.updates=70"), "updates = 70, and this"),
        ("description.toml", lambda: "name = ", "description.toml"),
    ],
)
def test_a_look_at_what_is_to_be_done_finds_what_doing_it_would(
    campaign: list[str], tmp_path: Path, file: str, content: Callable[[], str], expected: str
) -> None:
    folder = tmp_path / "out" / PART
    (folder / file).parent.mkdir(parents=True)
    (folder / file).write_text(content())
    before = sorted(tmp_path.rglob("*"))
    compare = ["compare", "3agent_hopper", "--quick", "--seeds", "0", "--out", str(folder)]
    done = refusal(campaign)
    assert expected in done
    for look in ([*campaign, "--dry-run"], [*campaign, *LOOK], [*compare, *LOOK]):
        assert refusal(look) == done
    assert sorted(tmp_path.rglob("*")) == before


def test_a_dry_run_finds_that_a_folder_cannot_be_made(campaign: list[str], tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    assert "cannot make" in refusal(campaign)
    assert f"{tmp_path / 'out'} is not a folder" in refusal([*campaign, "--dry-run"])


def test_a_mechanism_s_status_is_of_a_comparison(tmp_path: Path) -> None:
    (tmp_path / "description.toml").write_text(_description("seed=0"))
    (tmp_path / "run.json").write_text("{}")
    words = ["mechanism", "3agent_hopper", "--quick", "--checkpoints", str(tmp_path)]
    assert "is the folder of a run, not of a comparison" in refusal(words)
    assert refusal([*words, *LOOK]) == refusal(words)
