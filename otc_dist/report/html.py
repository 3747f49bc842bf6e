"""A self-contained page: its style, and the few elements that reports are made of."""

from collections.abc import Callable, Iterable, Mapping, Sequence

from otc_dist.report import svg
from otc_dist.terminal.printable import on_page

_STYLE = """
:root { color-scheme: light dark; --page: #f5f6f8; --card: #ffffff; --text: #1b2430;
  --muted: #5d6875; --line: #e2e6eb; --warn: #8a5300; --warn-page: #fff4dd; --good: #12694a;
  --good-page: #e3f4ec; --bad: #a3271c; --bad-page: #fdeae7; --open-page: #eceff3; }
@media (prefers-color-scheme: dark) {
:root { --page: #12161b; --card: #1a2027; --text: #e6eaef; --muted: #9aa6b3; --line: #2c353f;
  --warn: #ffc766; --warn-page: #35290f; --good: #6fdcae; --good-page: #10301f;
  --bad: #ff9d91; --bad-page: #3a1814; --open-page: #232b34; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--text);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 28px 20px 60px; }
h1 { font-size: 25px; margin: 0; line-height: 1.25; } h2 { font-size: 17px; margin: 0 0 10px; }
.lead { color: var(--muted); margin: 2px 0 0; }
section { background: var(--card); border: 1px solid var(--line); border-radius: 10px;
  padding: 16px 18px; margin-top: 16px; overflow-x: auto; }
.pair { display: grid; gap: 0 16px;
  grid-template-columns: repeat(auto-fill, minmax(min(420px, 100%), 1fr)); }
.notice { background: var(--warn-page); color: var(--warn); border-radius: 8px; margin-top: 14px;
  padding: 9px 14px; } .notice strong { font-weight: 650; }
.verdict { border-radius: 10px; margin-top: 16px; padding: 12px 16px 13px;
  background: var(--open-page); border-left: 6px solid var(--muted); }
.verdict p { margin: 6px 0 0; } .verdict p:first-child { margin: 0; font-size: 19px;
  font-weight: 650; line-height: 1.35; }
.verdict.good { background: var(--good-page); border-color: var(--good); }
.verdict.good p:first-child { color: var(--good); }
.verdict.bad { background: var(--bad-page); border-color: var(--bad); }
.verdict.bad p:first-child { color: var(--bad); }
.figures { display: grid; gap: 12px; margin-top: 16px;
  grid-template-columns: repeat(auto-fit, minmax(140px, 1fr)); }
.figure { background: var(--card); border: 1px solid var(--line); border-radius: 10px;
  padding: 10px 14px; } .figure b { display: block; font-size: 20px; font-weight: 650;
  white-space: nowrap;
  font-variant-numeric: tabular-nums; line-height: 1.3; }
.figure span, .note { color: var(--muted); font-size: 13px; } .note { margin: 10px 0 0; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 5px 9px; border-bottom: 1px solid var(--line);
  white-space: nowrap; } th { color: var(--muted); font-weight: 500; font-size: 13px; }
tr:last-child td { border-bottom: 0; } th:first-child, td:first-child { text-align: left; }
table.facts td { text-align: left; white-space: normal; overflow-wrap: anywhere; }
table.facts td:first-child { color: var(--muted); width: 210px; }
tr.sum td { font-weight: 600; }
.dot { display: inline-block; width: 9px; height: 9px; border-radius: 5px; margin-right: 6px;
  background: var(--c); }
.wide { display: block; } .narrow { display: none; }
.grid-of-charts { display: grid; gap: 10px 14px;
  grid-template-columns: repeat(auto-fill, minmax(min(300px, 100%), 1fr)); }
pre { margin: 0; white-space: pre-wrap; overflow-wrap: anywhere;
  font: 13px/1.45 ui-monospace, Menlo, Consolas, monospace; }
summary { cursor: pointer; color: var(--muted); } details { margin-top: 10px; }
details pre, details .pair, details table { margin-top: 10px; } pre + table { margin-top: 10px; }
@media screen and (max-width: 700px) {
.wide { display: none; } .narrow { display: block; }
main { padding: 18px 12px 40px; } section { padding: 12px; } h1 { font-size: 22px; }
.figures { grid-template-columns: 1fr 1fr; gap: 8px; } .verdict p:first-child { font-size: 17px; }
th, td { padding: 5px 7px; font-size: 14px; }
th:first-child, td:first-child { position: sticky; left: 0; background: var(--card); }
table.facts td { display: block; padding: 0; border: 0; }
table.facts td:first-child { width: auto; padding-top: 7px; font-size: 13px; } }
@media print { section, .figure { break-inside: avoid; } }
"""


def page(title: str, lead: str, parts: Iterable[str]) -> str:
    """A whole HTML document; `parts` are HTML."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{on_page(title)}</title><style>{_STYLE}{svg.STYLE}</style></head><body><main>\n"
        f'<h1>{on_page(title)}</h1><p class="lead">{on_page(lead)}</p>\n'
        + "\n".join(part for part in parts if part)
        + "\n</main></body></html>\n"
    )


def verdict(tone: str, sentence: str, more: Iterable[str] = ()) -> str:
    """What happened, coloured by `tone`: "good", "bad", or any other."""
    lines = "".join(f"<p>{on_page(text)}</p>" for text in (sentence, *more))
    return f'<div class="verdict {on_page(tone)}">{lines}</div>'


def notice(strong: str, text: str) -> str:
    """A line that cannot be overlooked."""
    return f'<div class="notice"><strong>{on_page(strong)}</strong> {on_page(text)}</div>'


def figures(items: Iterable[tuple[str, str]]) -> str:
    """Key figures in a row: (value, what it is)."""
    cells = "".join(
        f'<div class="figure"><b>{on_page(value)}</b><span>{on_page(text)}</span></div>'
        for value, text in items
    )
    return f'<div class="figures">{cells}</div>'


def section(title: str, *parts: str) -> str:
    """A box with a heading; `parts` are HTML."""
    heading = f"<h2>{on_page(title)}</h2>" if title else ""
    return f"<section>{heading}{''.join(parts)}</section>"


def pair(*parts: str) -> str:
    """Side by side where there is room."""
    return f'<div class="pair">{"".join(parts)}</div>'


def chart(draw: Callable[[float, float], str], width: float = 960, height: float = 380) -> str:
    """A chart as wide as the page, drawn once for screens and once for phones, by (width, height):
    one that is only made smaller has letters that nobody can read.
    """
    wide, narrow = draw(width, height), draw(360, 280)
    return f'<div class="wide">{wide}</div><div class="narrow">{narrow}</div>'


def charts(parts: Iterable[str]) -> str:
    """Small charts, as many beside each other as there is room for."""
    return f'<div class="grid-of-charts">{"".join(parts)}</div>'


def table(
    head: Sequence[str],
    body: Iterable[Sequence[str]],
    sums: int = 0,
    colours: Mapping[str, int] | None = None,
) -> str:
    """A table of text; the last `sums` rows stand out; cells that `colours` knows have a dot."""
    lines = [list(row) for row in body]

    def shown(text: str) -> str:
        colour = (colours or {}).get(text)
        dot = "" if colour is None else f'<span class="dot {svg.colour_class(colour)}"></span>'
        return dot + on_page(text)

    rows = "".join(
        f"<tr{' class=sum' if i >= len(lines) - sums else ''}>"
        + "".join(f"<td>{shown(cell)}</td>" for cell in row)
        + "</tr>"
        for i, row in enumerate(lines)
    )
    heads = "".join(f"<th>{shown(cell)}</th>" for cell in head)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"


def facts(items: Iterable[tuple[str, str]]) -> str:
    """Names and what they are."""
    rows = "".join(f"<tr><td>{on_page(k)}</td><td>{on_page(v)}</td></tr>" for k, v in items)
    return f'<table class="facts"><tbody>{rows}</tbody></table>'


def note(text: str) -> str:
    """Small print below a chart or a table."""
    return f'<p class="note">{on_page(text)}</p>'


def preformatted(text: str) -> str:
    """Text as it is: a command line, a file."""
    return f"<pre>{on_page(text)}</pre>"


def details(summary: str, *parts: str) -> str:
    """Folded away until asked for; `parts` are HTML."""
    return f"<details><summary>{on_page(summary)}</summary>{''.join(parts)}</details>"
