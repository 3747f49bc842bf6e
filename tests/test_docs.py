"""What the documentation names is there, and it reads well: links, files, modules, line lengths."""

import re
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [*(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG")), *DOCS]
LONGEST = 110  # characters of a line
TOPS = (
    *("otc_dist", "services", "launch", "tests", "benchmarks", "docs", "results", "examples"),
    r"\.ci",
)
# A path below one of our folders, or a file of the root by its name.
OURS = re.compile(
    rf"(?<![\w./-])((?:{'|'.join(TOPS)})/[\w./*-]*[\w*/]"
    r"|(?:README|CONTRIBUTING|CHANGELOG)\.md|pyproject\.toml|constraints\.txt)"
)
AMERICAN = re.compile(
    r"\b(behavior|color|center|neighbor|favor|license[sd]?(?! file)|artifact)s?\b"
    r"|\b\w+(?:al|ar|d|n|ial|yr)iz(?:e[sd]?|er|ing|ation)\b",
    re.I,
)
PAPER = "Online Tuning for Offline Decentralized Multi-Agent Reinforcement Learning"
EACH_PAGE = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def anchors(page: Path) -> set[str]:
    """What a link may name after a #: its headings, spelt as Git hosts spell them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.M)
    return {re.sub(r"[^\w\- ]", "", heading).lower().replace(" ", "-") for heading in headings}


@EACH_PAGE
def test_every_link_leads_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\((?!https?:)([^)]+)\)", page.read_text()):
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@EACH_PAGE
def test_every_file_and_module_that_is_named_exists(page: Path) -> None:
    """However often files move, no page sends a reader to one that is not there."""
    text = page.read_text()
    for name in OURS.findall(text):
        assert list(ROOT.glob(name.rstrip("/"))), name
    for module in re.findall(r"python -m ((?:otc_dist|tests)[\w.]*\w)", text):
        assert find_spec(module), module


def test_every_module_that_the_code_speaks_of_exists() -> None:
    """Named by its whole path, or by its name alone where it lies in the same folder."""
    rooms = "|".join(path.name for path in (ROOT / "otc_dist").iterdir() if path.is_dir())
    tops = "otc_dist|services|launch|benchmarks|tests|examples|docs"
    named = re.compile(rf"(?<![\w./-])((?:{tops}|{rooms})/[\w/]+\.py)\b")
    for top in ("otc_dist", "services", "launch"):
        for source in (ROOT / top).rglob("*.py"):
            for path in named.findall(source.read_text()):
                assert (ROOT / path).is_file(), f"{source.relative_to(ROOT)} speaks of {path}"


@EACH_PAGE
def test_lines_are_short(page: Path) -> None:
    """All but rows of tables, what programs printed, and comments that nobody sees."""
    text = re.sub(r"(?ms)^```text$.*?^```$", "", page.read_text())
    for line in text.splitlines():
        table = line.startswith("|") and page.parent != ROOT
        assert len(line) <= LONGEST or table or line.startswith("<!--"), line


@EACH_PAGE
def test_spelling_is_british(page: Path) -> None:
    text = re.sub(r"```.*?```|`[^`]*`|\]\([^)]*\)", "", page.read_text(), flags=re.S)
    found = AMERICAN.search(" ".join(text.split()).replace(PAPER, ""))
    assert not found, found and found[0]


def test_the_index_names_every_page() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    for page in DOCS:
        if page.parent.name == "docs" and page.name != "index.md":
            assert f"]({page.name})" in index, page.name


def test_the_readme_stays_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 220
