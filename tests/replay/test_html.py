"""The page that plays a deployment: what is in it, and what a browser makes of it."""

import base64
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from otc_dist.envs.registry import team_spec
from otc_dist.scenes.families import find
from otc_dist.scenes.scene import AGENT_COLOURS
from otc_dist.transitions import JointStep

from .browser import FRAMES, browse
from .conftest import Replay
from .played import play

ENV = "hopper-3x1"


@pytest.fixture(scope="module")
def deployment(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[JointStep]]:
    path = tmp_path_factory.mktemp("deployment") / "log.mcap"
    return path, play(ENV, path, 120)


@pytest.fixture
def page(deployment: tuple[Path, list[JointStep]], tmp_path: Path, replay: Replay) -> Path:
    out = tmp_path / "out.html"
    assert replay(deployment[0], "--html", out) == (0, f"{out}\n")
    return out


def timeline_of(page: Path) -> dict:
    (packed,) = re.findall(r'<script id="timeline"[^>]*>(.*?)</script>', page.read_text(), re.S)
    return json.loads(packed)


def array(packed: str, dtype: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed), dtype).reshape(shape)


def returns_so_far(steps: list[JointStep], copy: int) -> list[float]:
    """The plain way."""
    sums, total = [], 0.0
    for step in steps:
        total += float(step.rewards[0][copy])
        sums.append(total)
        if step.terminated[copy] or step.truncated[copy]:
            total = 0.0
    return sums


def test_the_page_holds_what_the_log_holds(page: Path, deployment) -> None:
    _, steps = deployment
    timeline = timeline_of(page)
    assert array(timeline["numbers"], "<i4", -1).tolist() == list(range(120))
    rewards = array(timeline["rewards"], "<f4", 120, 3)
    assert rewards.tobytes() == np.stack([np.stack(s.rewards)[:, 0] for s in steps]).tobytes()
    returns = array(timeline["returns"], "<f4", 120, 3)[:, 1]
    assert np.allclose(returns, returns_so_far(steps, 0), atol=1e-4)
    for i, agent in enumerate(timeline["agents"]):
        found = array(agent["actions"], "<f4", 120, 1)
        assert found.tobytes() == np.stack([s.actions[i][0] for s in steps]).tobytes()
    scene = find(team_spec(ENV))
    assert scene is not None
    poses = scene.frames(np.stack([s.state[0] for s in steps])).poses
    found = array(timeline["scene"]["poses"], "<f4", 120, 4, 3)
    assert np.array_equal(found, poses.astype(np.float32))


def test_the_page_stands_alone_and_escapes_what_it_is_given(page: Path) -> None:
    text = page.read_text()
    assert not re.search(r"""(src|href)\s*=|url\(|https?://|@import|fetch\(""", text)
    assert "<title>played-hopper-3x1, deployment 2</title>" in text


def test_the_same_log_gives_the_same_page(page: Path, deployment, tmp_path, replay) -> None:
    replay(deployment[0], "--html", tmp_path / "again.html")
    assert (tmp_path / "again.html").read_bytes() == page.read_bytes()


def test_a_part_of_a_log(deployment, tmp_path: Path, replay: Replay) -> None:
    """An agent, and steps from the middle of an episode, whose return counts from its start."""
    path, steps = deployment
    out = tmp_path / "part.html"
    replay(path, "--html", out, "--steps", "5:9", "--agent", "agent_2")
    timeline = timeline_of(out)
    assert [agent["name"] for agent in timeline["agents"]] == ["agent_2"]
    assert array(timeline["numbers"], "<i4", -1).tolist() == [5, 6, 7, 8]
    assert np.allclose(
        array(timeline["returns"], "<f4", -1), returns_so_far(steps, 0)[5:9], atol=1e-5
    )


def test_episodes_are_named_by_their_copy_and_their_place_in_it(
    page: Path, deployment, tmp_path: Path, replay: Replay
) -> None:
    path, steps = deployment
    timeline = timeline_of(page)
    ends = [t for t, s in enumerate(steps[:-1]) if s.terminated[0] or s.truncated[0]]
    assert len(ends) >= 2
    names = [f"copy 0, its {n} episode" for n in ("1st", "2nd", "3rd")]
    assert timeline["names"][:3] == names and len(timeline["names"]) == len(ends) + 1
    # One that is shown alone is still its copy's second.
    second = array(timeline["episodes"], "<i4", -1)[ends[0] + 1]
    replay(path, "--html", tmp_path / "one.html", "--episode", second)
    assert timeline_of(tmp_path / "one.html")["names"] == names[1:2]


def test_an_episode_of_another_copy(deployment, tmp_path: Path, replay: Replay) -> None:
    path, steps = deployment
    out = tmp_path / "episode.html"
    replay(path, "--html", out, "--episode", "1")
    timeline = timeline_of(out)
    length = len(array(timeline["numbers"], "<i4", -1))
    rewards = array(timeline["rewards"], "<f4", length, 3)[:, 0]
    assert rewards.tolist() == [float(s.rewards[0][1]) for s in steps[:length]]
    assert steps[length - 1].terminated[1]


def test_discrete_actions_have_names(tmp_path: Path, replay: Replay) -> None:
    path = tmp_path / "log.mcap"
    play("5m_vs_6m", path, 3)
    replay(path, "--html", tmp_path / "out.html")
    timeline = timeline_of(tmp_path / "out.html")
    names = timeline["scene"]["choices"]
    assert len(names) == timeline["agents"][0]["choices"] == 12
    assert names[:3] == ["no-op", "stop", "north"] and names[6] == "attack 0"
    colours = [tuple(colour) for colour in timeline["choices"]]
    assert len(set(colours)) == 12  # each has its own in the strips
    assert len(set(colours[0])) == 3 and max(colours[0]) - min(colours[0]) < 20  # idle: grey


def test_an_environment_that_cannot_be_drawn(recorded, tmp_path: Path, replay: Replay) -> None:
    _, path = recorded
    replay(path, "--html", tmp_path / "out.html")
    assert timeline_of(tmp_path / "out.html")["scene"] is None


def test_mistakes(page: Path, deployment, tmp_path: Path, refused: Callable[..., str]) -> None:
    path, _ = deployment
    before = page.read_bytes()
    assert f"{page} exists; --force replaces it" in refused(path, "--html", page)
    assert "one FILE, not of 2" in refused(path, path, "--html", tmp_path / "two.html")
    assert "no episode 99" in refused(path, "--html", tmp_path / "none.html", "--episode", "99")
    assert page.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.html"]


# ---- In a browser


# What a user does, and what then stands in the page.
_USE = """
<script>
const seen = {};
const note = (name) => {
  const text = (id) => document.getElementById(id).textContent;
  seen[name] = ["step", "episode", "reward", "return"].map(text);
};
const press = (key, shiftKey = false) =>
  document.dispatchEvent(new KeyboardEvent("keydown", { key, shiftKey }));
const frame = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
window.addEventListener("error", (event) => { seen.error = event.message; });
(async () => {
  note("linked");
  press("ArrowRight"); press("ArrowRight", true); await frame(); note("eleven on");
  press("End"); await frame(); note("end");
  press("Home"); await frame(); note("home");
  press("ArrowDown"); await frame(); note("second episode");
  const plot = document.querySelectorAll("#plots canvas")[3], box = plot.getBoundingClientRect();
  const event = { clientX: box.left + 64 + (box.width - 76) / 2, pointerId: 1, buttons: 1 };
  plot.setPointerCapture = () => {};
  plot.dispatchEvent(new PointerEvent("pointerdown", event)); await frame(); note("middle");
  const zoom = { clientX: event.clientX, deltaY: -400, cancelable: true };
  plot.dispatchEvent(new WheelEvent("wheel", zoom)); await frame(); seen.zoomed = [...shown];
  press("End"); await frame(); seen.followed = [...shown];
  plot.dispatchEvent(new MouseEvent("dblclick")); await frame(); seen.all = [...shown];
  press("Home"); press(" "); await wait(400); press(" "); await frame(); note("played");
  const out = document.createElement("pre");
  out.id = "seen";
  out.textContent = JSON.stringify(seen);
  document.body.append(out);
})();
</script>
</body>
"""


def number_of(text: str) -> float:
    return float(text.replace("\N{MINUS SIGN}", "-"))


@pytest.mark.slow
def test_a_browser_plays_the_page(page: Path, deployment, tmp_path: Path) -> None:
    _, steps = deployment
    used = tmp_path / "used.html"
    used.write_text(page.read_text().replace("<head>", FRAMES).replace("</body>", _USE))
    dom = browse(tmp_path / "profile", f"file://{used}#step=37", "--dump-dom")
    (found,) = re.findall(r'<pre id="seen">(.*?)</pre>', dom)
    seen = json.loads(found)
    assert "error" not in seen

    sums = returns_so_far(steps, 0)
    for name, step in {"linked": 37, "eleven on": 48, "end": 119, "home": 0, "middle": 59}.items():
        number, _, reward, total = seen[name]
        assert int(number) == step, name
        assert number_of(reward) == pytest.approx(steps[step].rewards[0][0], abs=6e-3)
        assert number_of(total) == pytest.approx(sums[step], rel=6e-3)
    first = next(t for t, s in enumerate(steps) if s.terminated[0] or s.truncated[0])
    assert int(seen["second episode"][0]) == first + 1
    assert seen["home"][1] == "copy 0, its 1st episode"
    assert seen["second episode"][1] == "copy 0, its 2nd episode"
    # Zoomed by e around the cursor; moving elsewhere takes the plots along.
    (first, last), (begin, end) = seen["zoomed"], seen["followed"]
    assert last - first == pytest.approx(119 / np.e) and (first + last) / 2 == pytest.approx(59.5)
    assert end == pytest.approx(119) and end - begin == pytest.approx(last - first)
    assert seen["all"] == [0, 119]
    # 0.4 s of it, at 8 ms a step.
    assert 10 <= int(seen["played"][0]) <= 100


@pytest.mark.slow
def test_a_browser_draws_the_page(page: Path, tmp_path: Path) -> None:
    """The links are there in their agents' colours, and they move."""
    places = []
    for step in (0, 15):
        shot = tmp_path / f"{step}.png"
        browse(
            tmp_path / "profile",
            f"file://{page}#step={step}",
            f"--screenshot={shot}",
            "--window-size=1280,1000",
        )
        pixels = np.array(Image.open(shot).convert("RGB")).astype(int)[100:540, 20:960]
        for colour in AGENT_COLOURS[:3]:
            near = (np.abs(pixels - np.array(colour)) < 8).all(axis=2)
            assert near.sum() > 500, colour
            places.append(np.argwhere(near).mean(axis=0))
    moved = np.linalg.norm(np.array(places[:3]) - np.array(places[3:]), axis=1)
    assert moved.max() > 4  # pixels
