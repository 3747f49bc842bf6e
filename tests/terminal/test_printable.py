"""Nothing that comes from elsewhere moves a terminal's cursor or adds a line of its own."""

import io
import subprocess
import sys
from pathlib import Path

import pytest

from otc_dist.terminal.printable import aligned, on_page, printable, say

# Clear the screen, go up, set a title, C1's form of an escape, backspaces, a new line, delete;
# right-to-left, zero width, a line separator, half of a pair, a byte of a name that is no UTF-8.
ODD = (
    "\x1b[2J", "\x1b[1A", "\x1b]0;x\x07", "\x9b2J", "a\b\b", "a\nb", "a\rb", "\x7f",
    "\u202e", "\u200b", "\u2028", "\ud800", "\udcff",
)  # fmt: skip


@pytest.mark.parametrize("text", ODD)
def test_what_cannot_be_seen_is_shown_escaped(text: str) -> None:
    assert printable(text).isprintable() and "\\" in printable(text)
    assert printable(text).encode("utf-8")
    assert printable(f"𝔻 = ±3 {text} µ").startswith("𝔻 = ±3 ")


def test_lines_stay_where_they_are_ours() -> None:
    out = io.StringIO()
    say("a\nb", Path("c\x1b[2J"), 3, file=out)
    assert out.getvalue() == "a\nb\nc\\x1b[2J\n3\n"


def test_a_page_keeps_lines_and_shows_the_rest() -> None:
    assert on_page("a\n\t<b>\x1b[0m\x00\u202e") == "a\n\t&lt;b&gt;\\x1b[0m\\x00\\u202e"


def test_a_tables_columns_are_aligned_as_they_are_shown() -> None:
    rows = [("name", "n"), ("a\x1b", "10")]
    assert aligned(rows) == ["name   n", "a\\x1b  10"]
    assert aligned(rows, str.rjust) == ["name    n", "a\\x1b  10"]


@pytest.mark.parametrize("module", ["replay", "report", "launch.status", "datasets import"])
def test_a_file_name_is_shown_escaped_by_every_command(tmp_path: Path, module: str) -> None:
    name = "\x1b[2J\x1b]0;owned\x07\nerror: nothing\udcff"
    command = [sys.executable, "-m", *f"otc_dist.{module}".replace(".status", " status").split()]
    done = subprocess.run([*command, str(tmp_path / name)], capture_output=True, check=False)
    assert done.returncode == 2 and not done.stdout
    line = done.stderr.decode()
    assert line.count("\n") == 1 and line.rstrip("\n").isprintable(), line
    assert r"\x1b[2J\x1b]0;owned\x07\nerror: nothing\udcff" in line
