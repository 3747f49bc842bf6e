"""Films and sheets: what is to be seen on them, and what is said where there are none."""

import argparse
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from otc_dist.deployment_log.reader import read_summary
from otc_dist.replay import offscreen
from otc_dist.replay.frames import HEIGHT, WIDTH, renderer
from otc_dist.replay.timeline import highlights
from otc_dist.scenes.robots import RobotScene
from otc_dist.scenes.scene import AGENT_COLOURS, FOE
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import JointStep

from .conftest import Replay
from .played import play

PICTURE = WIDTH - 320  # px, without the panel


@pytest.fixture(scope="module")
def chase(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[JointStep]]:
    path = tmp_path_factory.mktemp("chase") / "log.mcap"
    return path, play("predator-prey-3", path, 30)


def frames_of(film: Path) -> tuple[list[np.ndarray], float]:
    """RGB pictures, and how many a second."""
    with av.open(film) as container:
        rate = float(container.streams.video[0].average_rate)
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)], rate


def place_of(picture: np.ndarray, colour: tuple[int, int, int], within: int) -> tuple[float, ...]:
    """The middle (x, y) of what has a colour, in px."""
    near = (np.abs(picture[:, :PICTURE].astype(int) - colour) < within).all(axis=2)
    assert near.sum() > 40
    return tuple(np.argwhere(near).mean(axis=0)[::-1])


def test_a_film_shows_each_step_of_a_slow_task(chase, tmp_path: Path, replay: Replay) -> None:
    path, steps = chase
    out = tmp_path / "out.mp4"
    assert replay(path, "--video", out, "--steps", "0:30") == (0, f"{out}\n")
    frames, rate = frames_of(out)
    assert rate == 10 and len(frames) == 30 and frames[0].shape == (HEIGHT, WIDTH, 3)
    scale = HEIGHT / 2.2
    for t in (0, 12):
        points = steps[t].observations[0][0].reshape(-1, 2)
        apart = np.linalg.norm(points[:, None] - points[None], axis=2) + 9 * np.eye(4)
        for i, colour in enumerate((*AGENT_COLOURS[:3], FOE)):
            if apart[i].min() > 0.15:  # nobody covers it
                expected = (PICTURE / 2 + scale * points[i, 0], HEIGHT / 2 - scale * points[i, 1])
                assert place_of(frames[t], colour, 28) == pytest.approx(expected, abs=3)
    # The panel's text and bars change as well.
    assert (np.abs(frames[0][:, PICTURE:].astype(int) - frames[12][:, PICTURE:]) > 60).any()


def test_the_same_log_gives_the_same_pictures(chase, tmp_path: Path, replay: Replay) -> None:
    for name in ("a.png", "b.png"):
        replay(chase[0], "--sheet", tmp_path / name, "--steps", "3:9")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_sheet_shows_twelve_moments(chase, tmp_path: Path, replay: Replay) -> None:
    path, _ = chase
    assert replay(path, "--sheet", tmp_path / "all.png", "--steps", "0:30")[0] == 0
    sheet = np.asarray(Image.open(tmp_path / "all.png"))
    assert sheet.shape[:2] == ((4 * (HEIGHT + 8) + 8) // 2, (3 * (WIDTH + 8) + 8) // 2)
    corner = sheet[4 : 4 + HEIGHT // 2, 4 : 4 + WIDTH // 2]
    last = sheet[-4 - HEIGHT // 2 : -4, -4 - WIDTH // 2 : -4]
    assert (np.abs(corner.astype(int) - last) > 60).sum() > 200
    replay(path, "--sheet", tmp_path / "few.png", "--steps", "0:2")
    assert Image.open(tmp_path / "few.png").size == (sheet.shape[1], (HEIGHT + 16) // 2)


def test_a_film_and_a_sheet_show_the_best_and_the_worst_episode(
    tmp_path: Path, replay: Replay
) -> None:
    path, out = tmp_path / "log.mcap", tmp_path / "out.png"
    play("5m_vs_6m", path, 50)
    episodes = read_summary(path).episodes
    whole = [one for one in episodes if one.terminated or one.truncated]
    returns = [float(np.mean(one.returns)) for one in whole]
    assert len(whole) >= 3 and len(episodes) > len(whole)
    (best, first), (worst, second) = highlights(argparse.Namespace(
        files=[path], steps=None, episode=None, agent=None))  # fmt: skip
    assert (best, worst) == (f"best of {len(whole)} episodes", f"worst of {len(whole)} episodes")
    assert first.returns[-1].mean() == pytest.approx(max(returns), abs=1e-4)
    assert second.returns[-1].mean() == pytest.approx(min(returns), abs=1e-4)
    for timeline in (first, second):
        assert timeline.ended[-1] and not timeline.ended[:-1].any()
    assert replay(path, "--sheet", out)[0] == 0
    assert replay(path, "--video", tmp_path / "out.mp4")[0] == 0
    assert len(frames_of(tmp_path / "out.mp4")[0]) == len(first) + len(second)
    # The sheet's upper half is the best, its lower half the worst.
    sheet = np.asarray(Image.open(out).convert("RGB")).astype(int)
    half = 2 * (HEIGHT + 8) // 2
    for timeline, top in ((first, 4), (second, 4 + half)):
        with renderer(timeline, "") as render:
            picture = render(0).resize((WIDTH // 2, HEIGHT // 2), Image.Resampling.LANCZOS)
        found = sheet[top : top + HEIGHT // 2, 4 : 4 + PICTURE // 2]
        wanted = np.asarray(picture)[:, : PICTURE // 2]
        assert (np.abs(found - wanted) > 60).sum() == 0


def test_many_agents_and_a_skirmish(tmp_path: Path, replay: Replay) -> None:
    for env_id in ("5m_vs_6m", "cooperative-navigation-12"):
        path = tmp_path / f"{env_id}.mcap"
        play(env_id, path, 6)
        assert replay(path, "--sheet", tmp_path / f"{env_id}.png")[0] == 0


def test_mistakes(
    chase, recorded, tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, _ = chase
    (tmp_path / "there.mp4").write_bytes(b"mine")
    assert "exists; --force replaces it" in refused(path, "--video", tmp_path / "there.mp4")
    said = refused(recorded[1], "--video", tmp_path / "out.mp4")
    assert "test-team do not say what it looks like" in said and "--html" in said
    monkeypatch.setitem(sys.modules, "av", None)
    said = refused(path, "--video", tmp_path / "out.mp4")
    assert "needs the package av" in said and "-m pip install 'av" in said
    assert [p.name for p in tmp_path.iterdir()] == ["there.mp4"]
    assert (tmp_path / "there.mp4").read_bytes() == b"mine"


def test_a_film_that_fails_leaves_nothing(
    chase, tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("otc_dist.replay.drawing.Panel.draw", full)
    assert "No space left on device" in refused(chase[0], "--video", tmp_path / "out.mp4")
    assert list(tmp_path.iterdir()) == []


# ---- Robots


@pytest.fixture(scope="module")
def hops(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hops") / "log.mcap"
    play("hopper-3x1", path, 40)
    return path


def test_without_a_library_for_it_one_line_says_so(
    hops: Path, tmp_path: Path, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A probe that fails, as it does where the libraries are not installed."""

    def fails(command: list[str], **_: object) -> subprocess.CompletedProcess[bytes]:
        return subprocess.CompletedProcess(command, 1)

    monkeypatch.setattr(offscreen.subprocess, "run", fails)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    said = refused(hops, "--sheet", tmp_path / "out.png")
    assert "egl and osmesa cannot be used here" in said and "apt-get install" in said
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert "but osmesa cannot be used" in refused(hops, "--video", tmp_path / "out.mp4")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_robot_is_rendered_in_its_agents_colours(
    hops: Path, tmp_path: Path, replay: Replay
) -> None:
    out = tmp_path / "out.mp4"
    try:
        replay(hops, "--video", out, "--steps", "0:40")
    except UserError as error:
        pytest.skip(str(error))
    frames, rate = frames_of(out)
    assert rate == 31.25 and len(frames) == 10  # 0.32 s at every fourth of its 125 steps a second
    picture = frames[0][:, :PICTURE].astype(int)
    blue, orange, green = (
        (picture[..., a] - picture[..., b] > 60) & (picture[..., a] - picture[..., c] > 20)
        for a, b, c in ((2, 0, 1), (0, 2, 1), (1, 0, 2))
    )
    heights = [np.argwhere(link)[:, 0].mean() for link in (blue, orange, green)]
    assert heights == sorted(heights)  # thigh, leg, foot: it stands
    assert all(link.sum() > 200 for link in (blue, orange, green))


@pytest.mark.slow
def test_a_robot_fills_the_picture_and_is_followed(hops: Path) -> None:
    scene = RobotScene("hopper-3x1")
    assert 1.2 < scene.top < 1.7  # m
    ((_, timeline),) = highlights(
        argparse.Namespace(files=[hops], steps=(0, 1), episode=None, agent=None)
    )
    moved = replace(
        timeline, states=timeline.states + np.eye(1, timeline.states.shape[1], 1) * 50.0
    )  # along x
    try:
        pictures = []
        for one in (timeline, moved):
            with renderer(one, "") as render:
                pictures.append(np.asarray(render(0))[:, :PICTURE].astype(int))
    except UserError as error:
        pytest.skip(str(error))
    for picture in pictures:
        blue = picture[..., 2] - picture[..., 0] > 60  # the thigh
        green = (picture[..., 1] - picture[..., 0] > 60) & (picture[..., 1] > picture[..., 2])
        high, low = np.flatnonzero(blue.any(axis=1))[0], np.flatnonzero(green.any(axis=1))[-1]
        assert low - high > 0.47 * HEIGHT  # from its upper end to the ground
        assert np.argwhere(blue)[:, 1].mean() == pytest.approx(PICTURE / 2, abs=40)
