"""A folder of something else than a comparison or a campaign: a mere look at it says so as well."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.comparison.scores import ComparisonFolder
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


def test_a_campaign_is_not_done_in_a_comparison(campaign: list[str], tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "description.toml").touch()
    for words in (campaign, [*campaign, "--dry-run"], [*campaign, *LOOK]):
        assert "out is the folder of a comparison or a run; use another --out" in refusal(words)
    assert len([*(tmp_path / "out").iterdir()]) == 1


def test_results_are_not_kept_in_the_comparison_itself(campaign: list[str], tmp_path: Path) -> None:
    out = str(tmp_path / "out")
    compare = ["compare", "3agent_hopper", "--quick", "--out", out]
    for words in (campaign, compare):
        said = refusal([*words, "--results", out])
        assert "is the comparison's own folder: use another --results" in said
    assert not Path(out).exists()


@pytest.mark.parametrize("flag", ["--out", "--results"])
def test_another_campaign_s_file_of_the_same_name_is_not_replaced(
    campaign: list[str], tmp_path: Path, flag: str
) -> None:
    there = tmp_path / "theirs" / "one.toml"
    there.parent.mkdir()
    there.write_text(Path(campaign[1]).read_text().replace("parts.one", "parts.two"))
    words = [*campaign[:3], flag, str(there.parent)]
    if flag == "--results":
        words += ["--out", str(tmp_path / "out")]
    assert f"{there} lists two as well, which {campaign[1]} does not" in refusal(words)
    assert "parts.two" in there.read_text() and len([*there.parent.iterdir()]) == 1


@pytest.mark.parametrize("file", ["run.json", "inputs.json"])
def test_results_are_not_kept_among_a_run_s_or_another_comparison_s(
    campaign: list[str], tmp_path: Path, file: str
) -> None:
    """Also one of the very same description, which it would seem to be of."""
    kept = tmp_path / "kept"
    (kept / PART).mkdir(parents=True)
    (kept / PART / file).write_text("{}")
    (kept / PART / "description.toml").write_text(_description("seed=0"))
    before = sorted(tmp_path.rglob("*"))
    out = ["--quick", "--out", str(tmp_path / "out")]
    compare = ["compare", "3agent_hopper", *out, "--results", str(kept / PART)]
    for words in (compare, [*campaign, "--results", str(kept)]):
        said = refusal(words)
        assert f"--results {kept / PART} is the folder of a run or of another comparison" in said
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["status"], "is the folder of a comparison, not of a run"),
        (["--resume"], "is the folder of a comparison, not of a run"),
        (["3agent_hopper", "--quick", "--from"], "name a seed of it, as seeds/seed_00"),
    ],
)
def test_a_comparison_is_no_run(tmp_path: Path, words: list[str], expected: str) -> None:
    (tmp_path / "seeds" / "seed_00").mkdir(parents=True)
    (tmp_path / "description.toml").write_text(_description("seed=0"))
    assert expected in refusal([*words, str(tmp_path)])


def test_a_mechanism_s_status_is_of_a_comparison(tmp_path: Path) -> None:
    (tmp_path / "description.toml").write_text(_description("seed=0"))
    (tmp_path / "run.json").write_text("{}")
    words = ["mechanism", "3agent_hopper", "--quick", "--checkpoints", str(tmp_path)]
    assert "is the folder of a run, not of a comparison" in refusal(words)
    assert refusal([*words, *LOOK]) == refusal(words)


def test_what_lies_beside_a_campaign_s_results_is_left_out_in_a_line(
    campaign: list[str], finished: ComparisonFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = Path(campaign[1]).parent / "kept"
    shutil.copytree(finished.root, kept / PART)
    shutil.copy(campaign[1], kept)
    tables = ["campaign", "--tables", str(kept)]
    assert main(tables) == 0
    found = capsys.readouterr()
    assert f"{PART}:" in found.out and found.err == ""
    (kept / "pyproject.toml").write_text("[project]\nname = 'mine'\n")
    (kept / "notes.toml").write_text("no TOML")
    (kept / "folder.toml").mkdir()
    shutil.copytree(finished.root, kept / "3agent_hopper-seed0")
    (kept / "3agent_hopper-seed0" / "run.json").write_text("{}")
    assert main(tables) == 0
    others = "3agent_hopper-seed0, folder.toml, notes.toml, pyproject.toml"
    assert capsys.readouterr() == (found.out, f"of no campaign, and left out: {others}\n")
    (kept / "one.toml").write_text("[parts.one]\ndescriptions = ['3agent_hopper']\n")
    assert "one.toml: seeds is missing" in refusal(tables)
    shutil.rmtree(kept / PART)
    assert "is not the folder of a campaign" in refusal(tables)
