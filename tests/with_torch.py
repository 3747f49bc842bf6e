"""`python tests/with_torch.py [VERSION ...]`: tests/steps with other versions of torch.

Each is installed in an environment of its own, with everything else as in constraints.txt; by
default the oldest that pyproject.toml allows. A version may be 5 GB of CUDA's libraries.
"""

import argparse
import re
import subprocess
import sys
import tomllib
import venv
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]


def oldest() -> str:
    """The oldest torch that pyproject.toml allows."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (bounds,) = (need for need in project["dependencies"] if re.match(r"torch\b", need))
    return re.findall(r">=([\d.]+)", bounds)[0]


def passes(version: str, folder: Path) -> bool:
    """Whether tests/steps pass with torch `version`, in an environment in `folder`."""
    environment = folder / version
    python = environment / "bin" / "python"
    if not python.exists():
        venv.create(environment, with_pip=True)
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    constraints = environment / "constraints.txt"
    constraints.write_text("\n".join(line for line in lines if not line.startswith("torch==")))
    install = (python, "-m", "pip", "install", "-q", "--no-cache-dir", "-c", constraints)
    wanted = (f"torch=={version}", "pytest", "pytest-xdist", "-e", ROOT)
    subprocess.run([*install, *wanted], check=True)
    tests = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/steps")
    return subprocess.run([python, *tests], cwd=ROOT, check=False).returncode == 0


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("versions", nargs="*", default=[oldest()], help="default: the oldest")
    parser.add_argument("--folder", type=Path, help="keep the environments there, for a next time")
    arguments = parser.parse_args()
    with TemporaryDirectory() as scratch:
        folder = arguments.folder or Path(scratch)
        verdicts = {one: passes(one, folder.resolve()) for one in arguments.versions}
    for version, passed in verdicts.items():
        print(f"torch {version}: tests/steps {'pass' if passed else 'FAIL'}")
    return 0 if all(verdicts.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
