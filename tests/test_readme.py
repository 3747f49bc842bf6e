"""Every command of README.md and docs/ is run: as it stands, or in the short form beside it."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
CONTRIBUTING = ROOT / "CONTRIBUTING.md"
DOCS = sorted((ROOT / "docs").rglob("*.md"))
REFERENCE = ROOT / "docs" / "reference"
INSTALL = "python3 -m venv .venv && .venv/bin/pip install -q -c constraints.txt -e "
NOTES = ("short", "says", "ci", "not run")


@dataclass(frozen=True)
class Command:
    """A line of a ```sh block, and what the HTML comment above the block says about it."""

    text: str
    note: str = ""
    value: str = ""

    @property
    def run(self) -> str | None:
        """What is run: the command, or <!-- short: ... --> in its place; None: nothing.

        Nothing of <!-- ci -->, since .ci/run runs the very block, and of <!-- not run: why -->.
        """
        if self.note in ("ci", "not run"):
            return None
        return self.value if self.note == "short" else self.text

    @property
    def says(self) -> str:
        """<!-- says: ... --> it ends with an error that holds this."""
        return self.value if self.note == "says" else ""


def commands(page: Path) -> list[Command]:
    found = []
    pattern = re.compile(
        r"(?:^<!-- (?P<note>[^\n]*?) -->\n)?^```sh\n(?P<block>.*?)^```$", re.M | re.S
    )
    for match in pattern.finditer(page.read_text()):
        note, _, value = (match["note"] or "").partition(": ")
        lines = re.sub(r"\\\n *", "", match["block"]).splitlines()
        found += [Command(line, note, value) for line in lines]
    return found


def ci(page: Path) -> list[str]:
    return [command.text for command in commands(page) if command.note == "ci"]


def files(page: Path) -> dict[str, str]:
    """What a page has its reader write: blocks below <!-- file: NAME -->."""
    pattern = re.compile(r"^<!-- file: (\S+) -->\n```\w+\n(.*?)^```$", re.M | re.S)
    return dict(pattern.findall(page.read_text()))


def perform(page: Path, folder: Path) -> None:
    """Run a page's commands in order, in one folder, since later ones look at what others leave."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for command in commands(page):
        if command.run is None:
            continue
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", command.run],
            cwd=folder,
            env={**os.environ, "PATH": path},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        if command.says:
            assert done.returncode != 0 and command.says in done.stderr, command.text
        else:
            assert done.returncode == 0, f"{command.text}\n{done.stdout}{done.stderr}"


def examples(page: Path) -> str:
    """What a page does in Python: all ```python blocks, one after the other."""
    return "\n".join(re.findall(r"(?ms)^```python\n(.*?)^```$", page.read_text()))


WRITTEN = {name: text for page in DOCS for name, text in files(page).items()}


def test_the_two_commands_install_alike() -> None:
    tests, main_job = (command.text for command in commands(README)[:2])
    assert tests == f"{INSTALL}'.[test]' && .venv/bin/python -m pytest -n auto --dist loadfile"
    assert main_job == f"{INSTALL}. && .venv/bin/python -m otc_dist.launch 3agent_hopper"


def test_ci_runs_the_blocks_marked_for_it_and_contributors_are_told_the_same() -> None:
    script = (ROOT / ".ci/run").read_text()
    cut = script.partition("blocks=")[2].partition("\n")[0]
    done = subprocess.run(
        ["bash", "-c", f'blocks={cut}; printf %s "$blocks"'],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == ci(README)
    assert len(ci(README)) == 2
    assert ci(CONTRIBUTING) == ci(README)


def test_pre_commit_checks_what_ci_does_after_the_tests() -> None:
    hooks = re.findall(
        r"^ +entry: \.venv/bin/(.+)$", (ROOT / ".pre-commit-config.yaml").read_text(), re.M
    )
    assert " && ".join(hooks) == ci(README)[-1]


def test_every_command_line_tool_is_shown() -> None:
    """Each package or module with a __main__ has an example that is run."""
    found = [command for page in (README, *DOCS) for command in commands(page)]
    text = "\n".join(command.text for command in found if command.run)
    for main in (ROOT / "otc_dist").rglob("__main__.py"):
        module = ".".join(main.parent.relative_to(ROOT).parts)
        assert f"python -m {module} " in text
    assert "python -m otc_dist.launch " in text


@pytest.mark.parametrize("page", [README, CONTRIBUTING, *DOCS], ids=lambda page: page.name)
def test_no_command_escapes(page: Path) -> None:
    """Commands stand in ```sh blocks, with notes that are known."""
    for command in commands(page):
        assert command.note in ("", *NOTES), command
        assert command.value or command.note in ("", "ci"), command
    assert not re.search(
        r"^ {4}(\.venv/bin/|python|bash)", re.sub(r"(?ms)^```.*?^```$", "", page.read_text()), re.M
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the README's commands have been run; each other page builds on what they leave."""
    made = tmp_path_factory.mktemp("commands")
    for name, text in WRITTEN.items():
        (made / name).write_text(text)
    perform(README, made)
    return made


@pytest.mark.slow
def test_every_command_of_the_readme_runs(folder: Path) -> None:
    assert (folder / "runs" / "3agent_hopper-seed0" / "report.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize("page", DOCS, ids=lambda page: page.name)
def test_every_command_of_a_page_runs(page: Path, folder: Path) -> None:
    perform(page, folder)


@pytest.mark.slow
@pytest.mark.parametrize("page", [README, REFERENCE / "policy.md", REFERENCE / "log.md"])
def test_every_example_in_python_runs(page: Path, folder: Path) -> None:
    assert examples(page)
    done = subprocess.run(
        [sys.executable, "-c", examples(page)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_examples_of_the_readme_have_three_lines_each() -> None:
    blocks = re.findall(r"(?ms)^```python\n(.*?)^```$", README.read_text())
    lines = [[line for line in block.splitlines() if line] for block in blocks]
    assert [len([x for x in block if not x.startswith("import")]) for block in lines] == [3, 3, 3]


@pytest.mark.slow
def test_git_ignores_what_the_commands_leave(folder: Path) -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout")
    for left in sorted(path for path in folder.iterdir() if path.name not in WRITTEN):
        name = f"{left.name}/" if left.is_dir() else left.name
        ignored = subprocess.run(["git", "check-ignore", "--quiet", name], cwd=ROOT, check=False)
        assert ignored.returncode == 0, f"git would take {name} into the repository"
