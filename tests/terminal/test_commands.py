"""All commands by one name: what is listed, what is near, what completes, what to install."""

import shlex
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from otc_dist import __version__
from otc_dist.__main__ import main
from otc_dist.system import extras
from otc_dist.terminal.commands import COMMANDS, OF_LAUNCH
from otc_dist.terminal.errors import UserError, unknown

ROOT = Path(__file__).parents[2]


def helped(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main([*words, "--help"])
    assert not ended.value.code
    return capsys.readouterr().out


def test_every_command_is_listed_and_has_its_own_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    listed = capsys.readouterr().out
    assert listed == helped(capsys)
    for name, command in COMMANDS.items():
        assert f"  {name} " in listed and command.help in listed
        parser = import_module(command.parser or command.module).command_line()
        assert parser.format_help() == helped(capsys, name)


def test_every_module_that_runs_is_a_command() -> None:
    mains = {f"otc_dist.{path.parent.name}.__main__" for path in ROOT.glob("*/*/__main__.py")}
    assert mains <= {command.module for command in COMMANDS.values()}


def test_the_launcher_s_help_shows_its_other_commands(capsys: pytest.CaptureFixture[str]) -> None:
    text = helped(capsys, "launch")
    assert set(OF_LAUNCH) >= {"compare", "mechanism", "status", "chaos"}
    for name, command in OF_LAUNCH.items():
        assert any(line.split() == [name, *command.help.split()] for line in text.splitlines())


def test_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"otc-dist {__version__}\n"


def test_what_a_command_sees_is_what_it_would_see_by_itself(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["otc-dist", "launch", "--list"])
    assert main(["launch", "--list"]) == 0
    assert "3agent_hopper" in capsys.readouterr().out
    assert sys.argv == ["otc-dist", "--list"]
    with pytest.raises(UserError, match="nowhere is not a run folder"):
        main(["status", "nowhere"])
    assert sys.argv == ["otc-dist", "status", "nowhere"]


@pytest.mark.parametrize(
    ("name", "known", "hint"),
    [
        ("compar", COMMANDS, "did you mean 'compare'?"),
        ("evn", ["env", "data"], "did you mean 'env'?"),
        ("pendulum", ["hopper", "medium"], "known: hopper, medium"),  # over half the letters
        ("--fooo", ["--from", "--role"], "known: --from, --role"),  # alike in their dashes
        ("walker", ["1agent_walker", "hopper"], "did you mean '1agent_walker'?"),
        ("hopper", ["1agent_hopper", "2agent_hopper"], "'1agent_hopper' or '2agent_hopper'?"),
    ],
)
def test_only_what_is_near_is_suggested(name: str, known: list[str], hint: str) -> None:
    assert str(unknown("word", name, known)).endswith(hint)


def test_an_unknown_command_is_one_line() -> None:
    with pytest.raises(UserError, match="unknown command 'replya'; did you mean 'replay'"):
        main(["replya", "x.mcap"])


@pytest.mark.parametrize("unset", ["--out", "--resume", "--from", "--certs", "--agent"])
def test_an_empty_value_is_no_value(unset: str) -> None:
    """It would be the current folder, or nothing at all."""
    with pytest.raises(UserError, match=rf"argument {unset}: nothing is given"):
        main(["launch", "3agent_hopper", "--quick", "--dry-run", unset, ""])


@pytest.mark.parametrize(
    "words",
    [
        ("launch", "navigation", "--seed"),
        ("launch", "--resume", "run", "--deployments"),
        ("certs", "certs", "--agents"),
        ("certs", "certs", "--agents", "1", "--days"),
        ("replay", "a.mcap", "--episode"),
        ("replay", "navigation/random", "--export", "csv", "--transitions"),
        ("chaos", "--seed"),
    ],
)
def test_a_number_that_is_none_is_said_in_words(words: tuple[str, ...]) -> None:
    with pytest.raises(UserError, match=rf"argument {words[-1]}: 'two' is not a whole number"):
        main([*words, "two"])


@pytest.mark.parametrize("rate", ["two", "0", "-1", "inf", "nan"])
def test_a_rate_is_a_number_above_0(rate: str) -> None:
    with pytest.raises(UserError, match=f"--rate: '{rate}' is not a number above 0"):
        main(["replay", "a.mcap", "--publish", f"--rate={rate}"])


def completed(script: str, *words: str) -> set[str]:
    """What bash completes the last of the words to."""
    array = f"COMP_WORDS=({shlex.join(words)}); COMP_CWORD={len(words) - 1}; _shtab_otc_dist"
    return set(
        subprocess.run(
            ["bash", "-c", f'{script}\n{array}\nprintf "%s\\n" "${{COMPREPLY[@]}}"'],
            capture_output=True, text=True, check=True,
        ).stdout.split()
    )  # fmt: skip


def test_commands_flags_and_choices_are_completed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--print-completion", "bash"]) == 0
    script = capsys.readouterr().out
    assert completed(script, "otc-dist", "") >= set(COMMANDS)
    assert completed(script, "otc-dist", "replay", "--ver") == {"--verify"}
    assert completed(script, "otc-dist", "datasets", "ma") == {"make"}
    assert completed(script, "otc-dist", "launch", "--role", "") == {"host", "learner"}
    with pytest.raises(UserError, match="invalid choice: 'csh'"):
        main(["--print-completion", "csh"])


def test_what_an_extra_needs_is_installed_by_a_command_that_works_anywhere() -> None:
    """It names this Python, and packages that every index has: not ourselves, and no file."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for extra in ("import", "export", "video", "mlflow", "smax"):
        words = shlex.split(extras.install(extra))
        assert words[:4] == [sys.executable, "-m", "pip", "install"]
        assert sorted(words[4:]) == sorted(project["optional-dependencies"][extra])
