"""Logs to replay, and the command run in this process."""

from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.replay.__main__ import main
from otc_dist.terminal.errors import UserError
from tests.deployment_log.conftest import Recording

from .played import play
from .recorded import Deployments

Replay = Callable[..., tuple[int, str]]


@pytest.fixture
def replay(capsys: pytest.CaptureFixture[str]) -> Replay:
    """Run the command; its exit status, and what it printed on the standard output."""

    def run(*arguments: object) -> tuple[int, str]:
        capsys.readouterr()
        status = main([str(argument) for argument in arguments])
        return status, capsys.readouterr().out

    return run


@pytest.fixture
def refused(replay: Replay) -> Callable[..., str]:
    """Run the command with a mistake in it; the one line that it answers with."""

    def run(*arguments: object) -> str:
        with pytest.raises(UserError) as caught:
            replay(*arguments)
        message = str(caught.value)
        assert "\n" not in message
        return message

    return run


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, Path]:
    """A deployment of 1,200 random steps in two copies, and its finished log of several chunks."""
    made = Recording(((50, 3), (40, 2)), copies=2, steps=1200)
    return made, made.finish(tmp_path_factory.mktemp("recorded") / "log.mcap")


@pytest.fixture(scope="session")
def hopper(tmp_path_factory: pytest.TempPathFactory) -> Deployments:
    """Two deployments of a run; hoppers fall, and the ends of the logs cut some off."""
    folder = tmp_path_factory.mktemp("hopper")
    paths = [folder / f"deployment_{k:02d}.mcap" for k in (1, 2)]
    steps = [play("hopper-3x1", paths[k], 150, run="r", deployment=k + 1) for k in (0, 1)]
    return Deployments(paths, steps)
