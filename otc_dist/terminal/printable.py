"""Text from elsewhere on a terminal or a page: control characters are shown, never obeyed.

A file's name, a note in a data set or a process's message may hold escape sequences that clear a
screen or fake a line. Whatever is no visible character is shown as Python writes it: `\\x1b`.
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import TextIO


def printable(text: str) -> str:
    """One line in which every character can be seen."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _shown(c) for c in text)


def on_page(text: str) -> str:
    """The same for HTML, where lines and tabs stay."""
    return escape("".join(c if c in "\n\t" else printable(c) for c in text))


def say(*lines: object, file: TextIO | None = None) -> None:
    """Print these at once, each as a line or several; to the standard output without a `file`."""
    text = "\n".join(map(printable, "\n".join(map(str, lines)).split("\n")))
    print(text, file=file or sys.stdout, flush=True)


def aligned(
    rows: Iterable[Sequence[str]], others: Callable[[str, int], str] = str.ljust
) -> list[str]:
    """A table's lines, two spaces between its columns, of which the first stands to the left.

    Args:
        rows: cells, as many in each.
        others: where the other columns stand: to the left, or, by `str.rjust`, to the right.
    """
    shown = [list(map(printable, row)) for row in rows]
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    sides = [str.ljust, *[others] * (len(widths) - 1)]
    return [
        "  ".join(
            side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True)
        ).rstrip()
        for row in shown
    ]


def _shown(character: str) -> str:
    return character.encode("unicode_escape").decode()
