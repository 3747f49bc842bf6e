"""Text from elsewhere on a terminal or a page: control characters are shown, never obeyed.

A file's name, a note in a data set or a process's message may hold escape sequences that clear a
screen or fake a line. Whatever is no visible character is shown as Python writes it: `\\x1b`.
"""

import sys
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


def _shown(character: str) -> str:
    return character.encode("unicode_escape").decode()
