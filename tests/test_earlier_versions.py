"""Runs that earlier versions made, kept in tests/earlier/, are still read as docs/versions.md says.

Each is a run of Navigation with networks of four units: its simulator has the same bits everywhere.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest

from otc_dist import Policy, read_log
from otc_dist.datasets.importers import import_files
from otc_dist.description import Description
from otc_dist.launch.plan import run_record
from otc_dist.replay.__main__ import main as replay
from otc_dist.report.write import write_report
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError
from tests.deployment_log.shown import shown

EARLIER = Path(__file__).parent / "earlier"
LOG = Path("deployments", "deployment_01.mcap")


@pytest.fixture(params=sorted(path.name for path in EARLIER.iterdir()))
def made(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy of a run folder, in which a report can be written."""
    return Path(shutil.copytree(EARLIER / request.param, tmp_path / "made"))


def test_a_log_is_read_played_again_and_imported(made: Path, tmp_path: Path) -> None:
    log = shutil.copy(made / LOG, tmp_path)  # apart from its policies, whose bits a processor has
    assert replay([str(log), "--verify"]) == 4  # unbound: log version 1
    assert replay([str(log), "--verify", "--accept-unbound"]) == 0
    assert len(read_log(made / LOG).agents["agent_0"]) == 40
    assert import_files([made / LOG], "earlier").transitions == 40


def test_what_viewers_show_of_a_log_is_the_same_today(made: Path, tmp_path: Path) -> None:
    """The first version wrote it in JSON, which stays in the file."""
    assert replay([str(made / LOG), "--foxglove", str(tmp_path / "shown.mcap")]) == 0
    before, now = (shown(path, "/transforms") for path in (made / LOG, tmp_path / "shown.mcap"))
    assert len(before) == len(now) == 10
    for old, new in zip(before, now, strict=True):
        assert (old.time, old.sequence) == (new.time, new.sequence)
        for theirs, ours in zip(old.content["transforms"], new.content.transforms, strict=True):
            assert theirs["child_frame_id"] == ours.child_frame_id
            there, here = theirs["translation"], ours.translation
            assert (here.x, here.y, here.z) == pytest.approx(tuple(there.values()), abs=1e-3)


def test_a_checkpoint_acts(made: Path) -> None:
    policy = Policy.load(made / "agents" / "agent_0" / "checkpoint_01.safetensors")
    actions = policy.act(np.zeros((3, policy.spec.observation_size), np.float32))
    assert actions.shape == (3, policy.spec.action_size) and np.isfinite(actions).all()
    assert policy.deployment == 1


def test_a_run_folder_is_looked_at_but_not_continued(made: Path) -> None:
    folder = RunFolder(made)
    assert write_report(folder) == folder.report
    assert Description.load(folder.description).env.id == "navigation"
    with pytest.raises(UserError, match=r"has changed since the run began|was begun with otc-dist"):
        run_record.reopen(folder)
