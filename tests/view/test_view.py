"""The page of a run that goes on: what it shows is what the log holds, and the newest of it."""

import base64
import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from otc_dist.envs.registry import team_spec
from otc_dist.replay import html
from otc_dist.run.folder import RunFolder
from otc_dist.scenes.families import find
from otc_dist.system.ports import Port
from otc_dist.terminal.errors import UserError
from otc_dist.view.newest import Newest, Step
from otc_dist.view.server import serve
from tests.launch.scrapes import asked_of, free_port
from tests.replay.browser import FRAMES, browse
from tests.replay.played import Playing
from tests.report.conftest import MadeRun

ENV = "5m_vs_6m"
STRETCH = 20  # steps: 4 s of 0.2 s each


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    """Of a run that goes on, and has no log yet."""
    folder = RunFolder(tmp_path / "run")
    folder.deployment(1).parent.mkdir(parents=True)
    folder.run_json.write_text('{"state": "running"}')
    return folder


@pytest.fixture
def first(folder: RunFolder) -> Playing:
    return Playing(ENV, folder.deployment(1), deployment=1)


@contextlib.contextmanager
def served(folder: RunFolder) -> Iterator[int]:
    """The port at which the view answers."""
    port, over, there = Port("127.0.0.1", free_port()), threading.Event(), threading.Event()

    class Said(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            there.set()
            return over.wait(timeout)

    thread = threading.Thread(target=serve, args=(folder, port, Said()))
    thread.start()
    assert there.wait(60.0)
    try:
        yield port.number
    finally:
        over.set()
        thread.join()


def array(packed: str, dtype: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed), dtype).reshape(shape)


def numbers_of(answer: str) -> list[int]:
    return array(json.loads(answer)["numbers"], "<i4", -1).tolist()


def test_the_newest_steps_are_shown_and_then_those_after_them(
    folder: RunFolder, first: Playing
) -> None:
    with served(folder) as port:
        assert "no step of a deployment has been taken yet" in asked_of(port, "")
        assert asked_of(port, "newest") == ""

        first.take(25)
        newest = asked_of(port, "newest")
        assert numbers_of(newest) == list(range(5, 25))
        (in_page,) = re.findall(
            r'<script id="timeline"[^>]*>(.*?)</script>', asked_of(port, ""), re.S
        )
        assert json.loads(in_page) == json.loads(newest)
        assert json.loads(newest)["title"] == "played-5m_vs_6m, deployment 1"
        scene = find(team_spec(ENV))
        assert scene is not None
        poses = scene.frames(np.stack([step.state[0] for step in first.steps[5:]])).poses
        shown = array(json.loads(newest)["scene"]["poses"], "<f4", STRETCH, 11, 3)
        assert np.array_equal(shown, poses.astype(np.float32))

        assert asked_of(port, "newest?deployment=1&step=24") == ""
        first.take(3)
        assert numbers_of(asked_of(port, "newest?deployment=1&step=24")) == [25, 26, 27]
        first.finish()
        assert asked_of(port, "newest?deployment=1&step=27") == ""
        assert numbers_of(asked_of(port, "newest?deployment=1&step=26")) == [27]

        second = Playing(ENV, folder.deployment(2), deployment=2)
        assert asked_of(port, "newest?deployment=1&step=27") == ""
        second.take(2)
        answer = json.loads(asked_of(port, "newest?deployment=1&step=27"))
        assert answer["deployment"] == 2 and numbers_of(json.dumps(answer)) == [0, 1]


def test_returns_count_from_where_their_episodes_began(folder: RunFolder) -> None:
    """Whatever was read before; hoppers fall after some steps."""
    playing, newest = Playing("hopper-3x1", folder.deployment(1), deployment=1), Newest(folder)
    total, returns, episode, episodes = 0.0, [], 1, []
    for until in (30, 50, 150):
        playing.take(until - len(playing.steps))
        for step in playing.steps[len(returns) :]:
            total += float(step.rewards[0][0])
            returns.append(total)
            episodes.append(episode)
            if step.terminated[0] or step.truncated[0]:
                total, episode = 0.0, episode + 1
        for seen in (None, Step(1, until - 8), Step(2, 5)):
            timeline = newest.stretch(seen)
            assert timeline is not None
            at = timeline.numbers
            assert len(at) == (7 if seen == Step(1, until - 8) else until)
            assert timeline.returns[:, 0] == pytest.approx(np.array(returns)[at])
            assert timeline.ordinals.tolist() == np.array(episodes)[at].tolist()
    assert episode > 2


def test_a_run_that_has_lost_steps_and_takes_them_again(folder: RunFolder, first: Playing) -> None:
    first.take(30)
    newest = Newest(folder)
    assert newest.stretch() is not None
    (log,) = folder.root.glob("deployments/*.partial")
    os.truncate(log, log.stat().st_size * 9 // 10)
    timeline = newest.stretch()
    assert timeline is not None and 20 < timeline.numbers[-1] + 1 < 30
    assert newest.stretch(Step(1, 28)) is None


def test_damage_is_said_and_the_view_goes_on(folder: RunFolder, first: Playing) -> None:
    first.take(10)
    (log,) = folder.root.glob("deployments/*.partial")
    whole = log.read_bytes()
    with served(folder) as port:
        log.write_bytes(whole[:-40] + b"\0" * 40)
        with pytest.raises(urllib.error.HTTPError) as refused:
            asked_of(port, "newest")
        assert refused.value.code == 503
        assert b"step 9 does not match its checksum" in refused.value.read()
        log.write_bytes(whole)
        assert numbers_of(asked_of(port, "newest")) == list(range(10))
        for wrong, code in (("newest?step=x", 503), ("etc/passwd", 404)):
            with pytest.raises(urllib.error.HTTPError) as refused:
                asked_of(port, wrong)
            assert refused.value.code == code


def test_what_cannot_be_shown_is_one_line(folder: RunFolder, tmp_path: Path) -> None:
    over = threading.Event()
    over.set()

    def refused(folder: RunFolder, port: Port) -> str:
        with pytest.raises(UserError) as why:
            serve(folder, port, over)
        return str(why.value)

    free = Port("127.0.0.1", free_port())
    for root in (tmp_path, folder.run_json):
        assert refused(RunFolder(root), free) == f"{root} is not a run folder: it has no run.json"
    folder.run_json.write_text('{"state": "stopped"}')
    assert "has no log of a deployment to show, and does not go on" in refused(folder, free)
    # Its steps are of another team than the environment's, and say nothing of bodies.
    other = MadeRun(tmp_path / "made").folder
    assert "the states of hopper-3x1 do not say what it looks like" in refused(other, free)
    Playing(ENV, folder.deployment(1)).take(1)
    with socket.socket() as there:
        there.bind(("127.0.0.1", 0))
        there.listen()
        taken = Port("127.0.0.1", there.getsockname()[1])
        assert refused(folder, taken) == f"cannot listen at {taken}: Address already in use"


def test_the_command_answers_until_it_is_ended(folder: RunFolder, first: Playing) -> None:
    first.take(2)
    port = free_port()
    command = [sys.executable, "-m", "otc_dist.view", str(folder.root), "--at", str(port)]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as view,
        contextlib.ExitStack() as stack,
    ):
        stack.callback(view.kill)
        assert view.stdout is not None
        assert view.stdout.readline() == f"http://127.0.0.1:{port}/\n"
        assert os.getpriority(os.PRIO_PROCESS, view.pid) == 19
        assert numbers_of(asked_of(port, "newest")) == [0, 1]
        again = subprocess.run(command, capture_output=True, text=True, check=False)
        assert again.returncode == 2
        line = f"error: cannot listen at 127.0.0.1:{port}: Address already in use\n"
        assert (again.stdout, again.stderr) == ("", line)
        view.send_signal(signal.SIGTERM)
        assert view.wait(60.0) == 0


@pytest.mark.slow
def test_a_browser_plays_one_stretch_after_the_other(
    folder: RunFolder, first: Playing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When it asks for more, a few steps more have been taken."""
    first.take(STRETCH)
    asked: list[Step] = []

    def stretch(newest: Newest, after: Step | None = None) -> object:
        if after is not None:
            asked.append(after)
            first.take(3)
        return whole(newest, after)

    whole, filled = Newest.stretch, html.filled
    monkeypatch.setattr(Newest, "stretch", stretch)
    monkeypatch.setattr(html, "filled", lambda *parts: filled(*parts).replace("<head>", FRAMES))
    with served(folder) as port:
        dom = browse(tmp_path / "profile", f"http://127.0.0.1:{port}/", "--dump-dom", seconds=6.0)
    assert asked[:2] == [Step(1, 19), Step(1, 22)]
    (lead,) = re.findall(r'<p class="lead" id="lead">(.*?)</p>', dom)
    shown = re.fullmatch(r"5m_vs_6m · steps (\d+) to (\d+) of copy 0", lead)
    assert shown and int(shown[2]) >= 25 and int(shown[2]) - int(shown[1]) == 2
    (step,) = re.findall(r'<dd id="step">(\d+)</dd>', dom)
    assert int(step) >= STRETCH
    assert "Live: the newest seconds" in dom
