"""An algorithm and a sampling strategy of the user's own, each one class in a file of theirs."""

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from otc_dist.datasets.inputs import Digests
from otc_dist.description import Description, user_code
from otc_dist.description.kinds import STRATEGIES
from otc_dist.launch.plan import descriptions
from otc_dist.launch.run.command import main
from otc_dist.learner import checkpoint
from otc_dist.learner.learner import Learner, Progress
from otc_dist.learner.policy import Policy
from otc_dist.replay.__main__ import main as replay
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError

from .. import toys
from ..brains import SPEC, brain, describe, online, silent, transitions, unsaved
from .conftest import Launcher

CHOSEN = ("algorithm.name=toys:Cloning", "sampling.name=toys:Recent")
SET = (*CHOSEN, "algorithm.rate=0.05", "sampling.span=500", "sampling.alpha=0.5")


@pytest.fixture(scope="module")
def ended(
    tmp_path_factory: pytest.TempPathFactory, tiny_flags: tuple[str, ...]
) -> tuple[RunFolder, Launcher]:
    """A run of both, started from the folder that holds their module."""
    place = tmp_path_factory.mktemp("own")
    shutil.copy(toys.__file__, place / "toys.py")
    flags = [flag for text in (*SET, "deployment.updates=0") for flag in ("--set", text)]
    launcher = Launcher("navigation", *tiny_flags, *flags, "--out", "run", cwd=place)
    assert launcher.finish() == 0, launcher.text
    return RunFolder(place / "run"), launcher


@pytest.fixture
def stranger(ended: tuple[RunFolder, Launcher], monkeypatch: pytest.MonkeyPatch) -> None:
    """Their module could be imported and is not; nothing is allowed."""
    monkeypatch.setattr(user_code, "_allowed", set())
    monkeypatch.delitem(sys.modules, "toys", raising=False)
    monkeypatch.syspath_prepend(ended[0].root.parent)


def test_both_run_through_the_launcher(ended: tuple[RunFolder, Launcher]) -> None:
    folder, _ = ended
    arrays, _ = checkpoint.read(folder.checkpoint("agent_0", 2))
    assert {"algorithm.weight", "algorithm.sampler_seen"} <= set(arrays)
    assert arrays["algorithm.sampler_seen"] == 2
    assert arrays["algorithm.updates"] == 60 + 2 * toys.CloningSection.tuning_updates
    first, _ = checkpoint.read(folder.checkpoint("agent_0", 0))
    assert (arrays["algorithm.weight"] != first["algorithm.weight"]).any()
    noted: Digests = json.loads(folder.run_json.read_text())["inputs"]
    assert {f"code of {text.partition('=')[2]}: toys.py" for text in CHOSEN} <= set(noted)


def test_their_settings_are_part_of_the_description(
    ended: tuple[RunFolder, Launcher], stranger: None
) -> None:
    folder, _ = ended
    text = tomllib.loads(folder.description.read_text())
    assert (text["sampling"]["span"], text["algorithm"]["rate"]) == (500, 0.05)
    unread = Description.load(folder.description)
    assert unread.to_toml() == folder.description.read_text()
    assert unread.digest() == json.loads(folder.run_json.read_text())["description"]
    assert unread.with_assignments("sampling.name=otc").sampling.model_dump()["alpha"] == 0.5


def test_a_distance_and_a_rule_of_acceptance_may_be_theirs_as_well(stranger: None) -> None:
    own = ("sampling.distance=toys:Late", "sampling.acceptance=toys:half")
    with pytest.raises(UserError, match="--allow toys:Late"):
        brain(*own)
    assert describe(*own).heading.endswith("OTC, toys:Late by toys:half")
    described = describe(*own).trusted()
    assert described.heading.endswith("OTC, late by toys:half")
    learner = Learner(described, SPEC, transitions(0, 200))
    learner.pretrain(silent, unsaved)
    told: list[Progress] = []
    learner.tune(1, online(1), told.append)
    assert told[0].metrics["accepted"] == 0.5
    with pytest.raises(UserError, match="toys:Nothing cannot be loaded"):
        describe("sampling.distance=toys:Nothing").trusted()


def test_the_example_of_the_docs_draws_the_newest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a reader would copy it."""
    page = (Path(__file__).parents[2] / "docs/method.md").read_text()
    (example,) = (
        block for block in re.findall(r"(?ms)^```python\n(.*?)^```$", page) if "Newest" in block
    )
    (tmp_path / "newest_of_the_docs.py").write_text(example)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(user_code, "_allowed", set())
    described = describe("sampling.name=newest_of_the_docs:Newest", "sampling.span=7").trusted()
    learner = Learner(described, SPEC, transitions(0, 200))
    learner.pretrain(silent, unsaved)
    learner.tune(1, online(1), silent)
    extent = learner._experience.extent
    drawn = learner._sampler.sample_indices(np.random.default_rng(0), 100, extent)["batch"]
    assert set(drawn.ravel()) == set(range(extent.size - 7, extent.size))


def test_a_new_strategy_of_the_package_leaves_all_other_descriptions_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(toys.__file__, tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    before = descriptions.load("navigation", (), None, quick=True)
    monkeypatch.setitem(STRATEGIES._places, "recent", "toys:Recent")  # a line of the registry
    after = descriptions.load("navigation", (), None, quick=True)
    assert (after.digest(), after.to_toml()) == (before.digest(), before.to_toml())
    chosen = after.with_assignments("sampling.name=recent", "sampling.span=7")
    back = chosen.with_assignments("sampling.name=otc")
    assert chosen.sampling.name == "recent" and back.sampling.model_dump()["span"] == 7


HOST = """
import sys
from pathlib import Path
from otc_dist.datasets import inputs
from otc_dist.services import env_host
run = env_host.Run.open(Path("run"))
run.check(inputs.sources(run.description))
print(run.description.sampling.name, "toys" in sys.modules, "torch" in sys.modules)
"""


def test_the_env_host_loads_neither_them_nor_torch(ended: tuple[RunFolder, Launcher]) -> None:
    told = subprocess.run(
        [sys.executable, "-c", HOST],
        cwd=ended[0].root.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout == "toys:Recent False False\n"


def test_a_learner_does_not_go_on_with_another_version_of_them(
    ended: tuple[RunFolder, Launcher],
) -> None:
    folder, _ = ended
    source = folder.root.parent / "toys.py"
    before = source.read_text()
    source.write_text(before + "# changed\n")
    command = [sys.executable, "-m", "otc_dist.services.learner", "--run", "run"]
    try:
        again = subprocess.run(
            [*command, "--agent", "agent_0"], cwd=source.parent, capture_output=True, text=True
        )
    finally:
        source.write_text(before)
    assert again.returncode == 2
    assert again.stderr == (
        "error: toys.py, of toys:Cloning, has changed since the run began: restore it, or start"
        " a new run\n"
    )


def test_reading_what_names_them_loads_nothing(
    ended: tuple[RunFolder, Launcher], stranger: None, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(ended[0].deployment(1))
    replay([log])
    capsys.readouterr()
    replay([log, "--verify"])
    assert "--allow toys:Cloning" in capsys.readouterr().out
    with pytest.raises(UserError, match="--allow toys:Cloning"):
        replay([log, "--publish", "--learners", "--run", str(ended[0].root.parent / "again")])
    with pytest.raises(UserError, match="allow='toys:Cloning'"):
        Policy.load(ended[0].root, deployment=1)
    assert "toys" not in sys.modules
    replay([log, "--verify", "--allow", "toys:Cloning"])
    assert "toys" in sys.modules and "--allow" not in capsys.readouterr().out


def test_what_its_code_raises_is_one_line(tiny_flags: tuple[str, ...], tmp_path: Path) -> None:
    text = Path(toys.__file__).read_text().replace("slope = imitated", "slope = batch.nothing")
    (tmp_path / "toys.py").write_text(text)
    flags = [flag for text in SET for flag in ("--set", text)]
    launcher = Launcher("navigation", *tiny_flags, *flags, "--out", "run", cwd=tmp_path)
    assert launcher.finish() == 2
    said = [line for line in launcher.lines if "toys:Cloning or toys:Recent failed" in line]
    assert "AttributeError" in said[0] and f"{tmp_path}/toys.py:" in said[0]
    assert "Traceback" not in launcher.text


MISTAKES = {
    "algorithm.name=toys:Nothing": "toys:Nothing cannot be loaded: AttributeError",
    "algorithm.name=nowhere:Cloning": "there is no module nowhere; start from the folder",
    "algorithm.name=toys:Recent": "toys:Recent has no Section made from AlgorithmSection",
    "sampling.name=toys:Recent,sampling.spam=1": "did you mean 'sampling.span'?",
    "sampling.name=toys:Recent,sampling.span=0": "sampling.span: input should be greater than",
    "sampling.name=toys:Recent,sampling.online_share=0.5": "chooses its online data itself",
}


@pytest.mark.parametrize(("given", "expected"), MISTAKES.items())
def test_a_mistake_in_one_is_one_line(
    given: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(toys.__file__, tmp_path / "toys.py")
    monkeypatch.syspath_prepend(tmp_path)
    flags = [flag for text in given.split(",") for flag in ("--set", text)]
    with pytest.raises(UserError) as refused:
        main(["navigation", "--quick", "--dry-run", *flags])
    assert expected in str(refused.value) and "\n" not in str(refused.value)
