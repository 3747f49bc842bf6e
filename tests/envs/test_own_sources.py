"""The sources of a user's own environment: all that it loads from its own folder, and no others."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FILES = {
    "pkg/__init__.py": "from .game import parallel_env",
    "pkg/game.py": """
import importlib
from pettingzoo import ParallelEnv
from gymnasium.spaces import Box
from beside import *
from pkg import levels
class Game(ParallelEnv):
    metadata = {"name": "game"}
    possible_agents = ["left", "right"]
    def observation_space(self, agent): return Box(-1, 1, (1,))
    def action_space(self, agent): return Box(-1, 1, (1,))
    def reset(self, seed=None, options=None):
        self.agents, self.t = list(self.possible_agents), 0
        return self.look(), {name: {} for name in self.agents}
    def look(self): return {name: [0.0] for name in self.agents}
    def step(self, actions):
        from .late import BONUS
        self.t += 1
        names = self.agents
        no, cut = dict.fromkeys(names, False), dict.fromkeys(names, self.t == 5)
        return self.look(), dict.fromkeys(names, BONUS), no, cut, dict.fromkeys(names, {})
def parallel_env():
    importlib.import_module("pkg.deep" + ".chosen")
    return Game()
""",
    "pkg/late.py": "BONUS = 100.0",
    "pkg/levels.py": "from . import more",
    "pkg/more.py": "",
    "pkg/deep/chosen.py": "from ..levels import more",
    "pkg/unused.py": "",
    "beside.py": "import otc_dist, numpy",
    "other.py": "",
}
LOADED = {"pkg/__init__.py", "pkg/game.py", "pkg/late.py", "pkg/levels.py", "pkg/more.py"}
LOADED |= {"pkg/deep/chosen.py", "beside.py"}
TELL = """
import sys
from otc_dist.description import user_code
from otc_dist.envs import registry
user_code.allow(sys.argv[1])
print(*registry.sources(sys.argv[1]))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of the user's, with packages installed in it and our own sources as well."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def python(folder: Path, *arguments: str) -> str:
    """What a fresh interpreter prints: modules are loaded once in a process."""
    environment = {**os.environ, "OTC_DIST_CACHE": str(folder / "cache")}
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, cwd=folder, env=environment, check=True, capture_output=True, text=True
    ).stdout


def test_what_is_imported_anywhere_from_its_own_folder_counts_and_nothing_else(
    folder: Path,
) -> None:
    assert set(python(folder, "-c", TELL, "pkg:parallel_env").split()) == LOADED


def test_of_an_installed_package_only_itself_counts() -> None:
    told = python(Path.cwd(), "-c", TELL, "mpe2.simple_spread_v3:parallel_env").split()
    assert "mpe2/simple_spread/simple_spread.py" in told
    assert {name.split("/")[0] for name in told} == {"mpe2"}


def test_data_are_made_again_when_any_of_the_sources_has_changed(folder: Path) -> None:
    make = ("-m", "otc_dist.datasets", "make", "pkg:parallel_env/random", "--transitions", "100")
    first = python(folder, *make)
    assert python(folder, *make) == first
    (folder / "pkg/late.py").write_text("BONUS = 7.0")
    (file,) = (folder / "cache").rglob("left.safetensors")
    before = file.read_bytes()
    python(folder, *make)
    assert file.read_bytes() != before


BEGIN = """
from pathlib import Path
from otc_dist.datasets import inputs
from otc_dist.launch.plan import descriptions, new_folder, run_record
from otc_dist.launch.run import resolve
from otc_dist.run.folder import RunFolder
from otc_dist.launch.plan.ledger import Ledger
from otc_dist.launch.plan.placement import Placement
small = ("env.id=pkg:parallel_env", "dataset.name=random", "dataset.transitions=100",
         "algorithm.name=td3bc", "engine.name=eager")
description = resolve.resolve(descriptions.load("navigation", small, None, quick=False))
folder = RunFolder(new_folder.make_folder(Path("run"), needed=0).root)
record = run_record.create(folder, description, quick=False, placement=Placement())
Ledger(record, folder).note_inputs(inputs.sources(description), description)
"""


def test_a_run_does_not_go_on_with_other_sources(folder: Path) -> None:
    """Neither its launcher, nor an env host that is started again in mid-run."""
    python(folder, "-c", BEGIN)
    (folder / "pkg/late.py").write_text("BONUS = 7.0")
    for command in (("launch", "--resume", "run"), ("services.env_host", "--run", "run")):
        with pytest.raises(subprocess.CalledProcessError) as refused:
            python(folder, "-m", f"otc_dist.{command[0]}", *command[1:])
        assert refused.value.returncode == 2
        assert refused.value.stderr == (
            "error: pkg/late.py, which pkg:parallel_env loads, has changed since the run began:"
            " restore it, or start a new run\n"
        )
