"""Every command of the README is run: as it stands, or in the short form written beside it."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
INSTALL = "python3 -m venv .venv && .venv/bin/pip install -q -c constraints.txt -e "


@dataclass(frozen=True)
class Command:
    """A line of a ```sh block, and what the HTML comment above the block says about it."""

    text: str
    short: str | None  # <!-- short: ... --> what is run instead
    says: str | None  # <!-- says: ... --> it ends with an error that holds this
    ci: bool  # <!-- ci --> .ci/run runs the very block


def commands() -> list[Command]:
    found = []
    pattern = re.compile(
        r"(?:^<!-- (?P<note>[^\n]*?) -->\n)?^```sh\n(?P<block>.*?)^```$", re.M | re.S
    )
    for match in pattern.finditer(README.read_text()):
        key, _, value = (match["note"] or "").partition(": ")
        for line in match["block"].splitlines():
            found.append(
                Command(
                    line,
                    short=value if key == "short" else None,
                    says=value if key == "says" else None,
                    ci=key == "ci",
                )
            )
    return found


def test_the_two_commands_install_alike() -> None:
    main_job, tests = commands()[0].text, commands()[1].text
    assert main_job == f"{INSTALL}. && .venv/bin/python -m otc_dist.launch 3agent_hopper"
    assert tests == (f"{INSTALL}'.[test]' && .venv/bin/python -m pytest -n auto --dist loadfile")
    assert commands()[1].ci


def test_ci_runs_the_blocks_marked_for_it() -> None:
    script = (ROOT / ".ci/run").read_text()
    cut = script.partition("blocks=")[2].partition("\n")[0]
    done = subprocess.run(
        ["bash", "-c", f'blocks={cut}; printf %s "$blocks"'],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == [command.text for command in commands() if command.ci]


def test_every_command_line_tool_is_shown() -> None:
    """Each package or module with a __main__ has an example."""
    text = "\n".join(command.text for command in commands())
    for main in (ROOT / "otc_dist").rglob("__main__.py"):
        module = ".".join(main.parent.relative_to(ROOT).parts)
        assert f"python -m {module} " in text
    assert "python -m otc_dist.launch " in text


@pytest.mark.slow
def test_every_command_runs(tmp_path: Path) -> None:
    """In order, in one folder, since later commands look at what earlier ones leave."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for command in commands():
        if command.ci:
            continue
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", command.short or command.text],
            cwd=tmp_path,
            env={**os.environ, "PATH": path},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        if command.says is None:
            assert done.returncode == 0, f"{command.text}\n{done.stdout}{done.stderr}"
        else:
            assert done.returncode != 0 and command.says in done.stderr, command.text
    if (ROOT / ".git").exists():
        for left in sorted(tmp_path.iterdir()):
            name = f"{left.name}/" if left.is_dir() else left.name
            ignored = subprocess.run(
                ["git", "check-ignore", "--quiet", name], cwd=ROOT, check=False
            )
            assert ignored.returncode == 0, f"git would take {name} into the repository"
