"""docs/reference is what the code says: the page of settings, and pages made of docstrings."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import otc_dist

ROOT = Path(__file__).parents[1]
REFERENCE = ROOT / "docs" / "reference"


@pytest.fixture(scope="module")
def written() -> str:
    """The page of settings, as it would be written now."""
    return str(runpy.run_path(str(ROOT / "docs" / "settings.py"))["page"]())


def test_the_page_of_settings_is_that_of_the_models(written: str) -> None:
    assert (REFERENCE / "settings.md").read_text() == written, "run `python docs/settings.py`"


def test_every_setting_has_a_meaning(written: str) -> None:
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \| (.*?) \|$", written, re.M)
    assert len(rows) > 80
    assert not [name for name, _, _, meaning in rows if not meaning]


def test_every_name_of_the_front_door_is_on_a_page() -> None:
    text = "\n".join(page.read_text() for page in REFERENCE.glob("*.md"))
    for name in set(otc_dist.__all__) - {"__version__", "UserError"}:
        assert re.search(rf"^::: otc_dist[\w.]*\.{name}$", text, re.M), name


@pytest.mark.slow
def test_the_pages_are_built_strictly(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path / "site")],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    page = (tmp_path / "site" / "reference" / "policy" / "index.html").read_text()
    assert 'id="otc_dist.learner.policy.Policy.load"' in page
    for loaded in re.findall(r'(?:src|<link[^>]+href)="(https?:[^"]*)"', page):
        pytest.fail(f"{loaded} would be fetched")
