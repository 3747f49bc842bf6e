"""What is installed is what is here: nothing missing, nothing else, and it runs from anywhere."""

import shutil
import site
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = {"otc_dist": "otc_dist", "services": "otc_dist.services", "launch": "otc_dist.launch"}


def _project() -> dict[str, object]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_folder_with_code_is_a_listed_package() -> None:
    listed = set(_project()["tool"]["setuptools"]["packages"])  # type: ignore[index]
    found = set()
    for folder, package in SOURCES.items():
        for init in (ROOT / folder).rglob("__init__.py"):
            below = init.parent.relative_to(ROOT / folder).parts
            found.add(".".join([package, *below]))
    assert found == listed


def test_every_requirement_is_pinned() -> None:
    pinned = {
        line.split("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    }
    project = _project()["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["test"]]  # type: ignore[index]
    names = {requirement.replace("[", ">").split(">")[0].lower() for requirement in wanted}
    assert names <= pinned


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the source distribution and of the wheel that is made from it alone."""
    source = tmp_path_factory.mktemp("source") / "checkout"
    unwanted = shutil.ignore_patterns(".*", "runs", "build", "__pycache__", "*.egg-info")
    shutil.copytree(ROOT, source, ignore=unwanted)
    out = tmp_path_factory.mktemp("built")
    subprocess.run([sys.executable, "-m", "build", "-o", out, source], check=True, timeout=300)
    return out


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    (found,) = built.glob("*.whl")
    return found


@pytest.mark.slow
def test_what_would_be_uploaded_would_be_taken(built: Path) -> None:
    files = sorted(built.iterdir())
    assert [path.suffix for path in files] == [".whl", ".gz"]
    check = [sys.executable, "-m", "twine", "check", "--strict", *files]
    assert subprocess.run(check, check=True, capture_output=True).stdout.count(b"PASSED") == 2


@pytest.mark.slow
def test_the_wheel_installs_nothing_but_otc_dist(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"otc_dist"}
    viewer = [f"replay/viewer/{part.name}" for part in (ROOT / "otc_dist/replay/viewer").iterdir()]
    layout = "replay/foxglove_layout.json"
    for needed in (
        "py.typed",
        "launch/3agent_hopper.toml",
        "launch/campaigns/paper-table1.toml",
        "envs/models/hopper.xml",
        layout,
        *viewer,
    ):
        assert f"otc_dist/{needed}" in names
    snapshots = [name for name in names if name.startswith("otc_dist/datasets/snapshots/")]
    shipped = [p for p in (ROOT / "otc_dist/datasets/snapshots").rglob("*") if p.is_file()]
    assert len(snapshots) == len(shipped) > 0


@pytest.mark.slow
def test_the_image_installs_the_same_from_what_it_is_given(wheel: Path, tmp_path: Path) -> None:
    """The Dockerfile's own step on what .dockerignore lets through, but for the dependencies."""
    rules = (ROOT / ".dockerignore").read_text().split("\n")
    assert rules[1] == "*"
    (given := tmp_path / "given").mkdir()
    for rule in rules:
        if rule.startswith("!") and (part := ROOT / rule[1:]).is_dir():
            shutil.copytree(part, given / part.name, ignore=shutil.ignore_patterns("__pycache__"))
        elif rule.startswith("!"):
            shutil.copyfile(part, given / part.name)
    lines = (ROOT / "Dockerfile").read_text().split("\n")
    (step,) = (line.removeprefix("RUN ") for line in lines if line.startswith("RUN python"))
    here = f" install --no-deps --no-build-isolation --target {tmp_path}/image "
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    environment = {"PATH": path, "TORCH": "http://nowhere.invalid"}
    step = step.replace(" install ", here)
    subprocess.run(step, shell=True, cwd=given, env=environment, check=True, timeout=300)
    installed = (path for path in (tmp_path / "image" / "otc_dist").rglob("*") if path.is_file())
    names = {str(p.relative_to(tmp_path / "image")) for p in installed if p.suffix != ".pyc"}
    ours = {n for n in zipfile.ZipFile(wheel).namelist() if n.startswith("otc_dist/")}
    assert names == ours


@pytest.mark.slow
def test_the_installed_launcher_runs_from_another_folder(
    wheel: Path, tmp_path: Path, tiny_flags: tuple[str, ...]
) -> None:
    """An environment that holds the wheel alone; the dependencies are looked up in this one's."""
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    python = tmp_path / "venv" / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", "--no-deps", wheel], check=True)
    # A path in a .pth file is searched; its own .pth files (an editable install's) are not read.
    (own,) = (tmp_path / "venv" / "lib").glob("python*/site-packages")
    (own / "dependencies.pth").write_text("\n".join(site.getsitepackages()) + "\n")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    where = subprocess.run(
        [python, "-c", "import otc_dist.launch; print(otc_dist.launch.__file__)"],
        cwd=elsewhere,
        check=True,
        capture_output=True,
        text=True,
    )
    assert Path(where.stdout.strip()).is_relative_to(own)
    script = python.with_name("otc-dist")
    subprocess.run([script, "launch", "3agent_hopper", *tiny_flags], cwd=elsewhere, check=True)
    assert (elsewhere / "runs" / "3agent_hopper-seed0" / "report.html").exists()
