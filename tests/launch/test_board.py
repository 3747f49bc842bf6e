"""What the launcher makes of statuses: events, who is waited for, and the time to go."""

import io

import pytest
from rich.console import Console

from otc_dist.bus.messages import Status
from otc_dist.envs import registry
from otc_dist.launch.plan import descriptions, forecast
from otc_dist.launch.plan.forecast import Part, Remaining
from otc_dist.launch.run.resolve import resolve
from otc_dist.launch.show.board import Board
from otc_dist.launch.show.view import CarefulView, LineView, TableView

RUN = [Part("offline", 0, 100.0), Part("deployment", 1, 10.0), Part("tuning", 1, 90.0)]


def board() -> Board:
    return Board(("agent_0", "agent_1"), Remaining(RUN))


def status(
    process: str, phase: str, deployment: int = 0, update: int = 0, **metrics: float
) -> Status:
    return Status(process, phase, deployment, update, 100, 5.0, metrics)


def test_an_event_is_told_once() -> None:
    seen = board()
    for update in (0, 10, 20):
        seen.take(status("agent_0", "offline", update=update), clock=float(update))
    assert seen.drain_events() == ["agent_0: offline"]
    assert seen.drain_events() == []


def test_alpha_and_returns_are_events_when_they_change() -> None:
    seen = board()
    for _ in range(2):
        seen.take(status("agent_0", "tuning", 1, alpha=1.25, similarity=0.5), clock=0.0)
        seen.take(status("host", "evaluation", 1, **{"return": 12.34}), clock=0.0)
    assert seen.drain_events() == [
        "agent_0: tuning after deployment 1",
        "agent_0: alpha 1.250, 𝔻 0.500",
        "host: evaluation, policy 1",
        "host: return 12.3",
    ]


def test_a_return_is_told_with_the_share_of_episodes_won() -> None:
    seen = board()
    seen.take(status("host", "evaluation", 1, **{"return": 12.34, "success": 46.9}), clock=0.0)
    assert seen.drain_events()[-1] == "host: return 12.3, 46.9 % won"


def test_what_a_deployment_measured_is_told_with_its_error() -> None:
    seen = board()
    seen.take(status("host", "deployment", 2, measured=2586.04, error=151.3), clock=0.0)
    assert seen.drain_events()[-1] == "host: deployment 2 measured 2,586.0 ± 151.3"


def test_an_episode_that_was_broken_off_is_told_once() -> None:
    seen = board()
    counts = {"held": 3.0, "late": 9.0}
    for broken_off in (0.0, 1.0, 1.0):
        seen.take(status("host", "deployment", 1, **counts, broken_off=broken_off), clock=0.0)
    line = "host: an episode was broken off; actions held so far: 3, late observations: 9"
    assert seen.drain_events().count(line) == 1
    seen.take(status("host", "reset", 1, **counts, broken_off=1.0), clock=0.0)
    assert seen.drain_events() == ["host: waiting for a reset in deployment 1"]


def test_nobody_knows_how_long_a_person_takes() -> None:
    seen = board()
    seen.take(status("agent_0", "ready", 2), clock=0.0)
    seen.take(status("agent_1", "ready", 2), clock=0.0)
    seen.take(status("host", "approval", 3), clock=0.0)
    assert seen.drain_events()[-1] == "host: waiting for a person to approve deployment 3"
    assert seen.seconds_left is None


def test_the_time_to_go_is_that_of_the_slowest_agent() -> None:
    seen = board()
    seen.take(status("agent_0", "offline", update=50), clock=0.0)
    assert seen.seconds_left is None  # nothing is known of agent_1
    seen.take(status("agent_1", "offline", update=10), clock=0.0)
    assert seen.seconds_left == pytest.approx(190.0)


def test_the_time_to_go_follows_what_the_machine_does() -> None:
    remaining = Remaining(RUN)
    assert remaining.seconds("offline", 0, 0.0, clock=50.0) == pytest.approx(200.0)
    # 200 s have brought what the table says takes 100: the other 100 take 200, nearly.
    left = remaining.seconds("deployment", 1, 0.0, clock=250.0)
    assert 180.0 < left < 200.0


def test_nothing_is_estimated_while_somebody_is_awaited() -> None:
    """Else the whole offline training would count as done, and the rest as slow without end."""
    judged = [RUN[0], Part("evaluation", 0, 0.0), *RUN[1:]]
    seen = Board(("agent_0", "agent_1"), Remaining(judged))
    for phase in ("waiting", "starting"):
        for clock, agent in enumerate(("agent_0", "agent_1")):
            seen.take(status("host", "gathering"), clock=float(clock))
            seen.take(status(agent, phase), clock=float(clock))
            seen.take(status("host", "evaluation", 0), clock=float(clock))
            assert seen.seconds_left is None
    for agent in ("agent_0", "agent_1"):
        seen.take(status(agent, "offline", update=50), clock=10.0)
    assert seen.seconds_left == pytest.approx(150.0)
    seen.take(status("agent_0", "ready"), clock=20.0)
    seen.take(status("agent_1", "ready"), clock=20.0)
    seen.take(status("host", "gathering"), clock=20.0)
    assert seen.seconds_left is None


def test_who_begins_again_further_back_is_not_taken_for_slow() -> None:
    remaining = Remaining(RUN)
    remaining.seconds("deployment", 1, 0.0, clock=0.0)
    assert remaining.seconds("offline", 0, 0.0, clock=100.0) == pytest.approx(200.0)


def test_agents_of_other_machines_do_not_share_our_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("otc_dist.launch.plan.forecast.os.cpu_count", lambda: 2)
    description = resolve(descriptions.load("3agent_hopper", ["engine.name=eager"], None, True))
    team = registry.team_spec(description.env.id)
    offline = {n: forecast.parts(description, team, n)[1].seconds for n in (0, 1, 3)}
    assert offline[0] == offline[1] == pytest.approx(offline[3] / 1.5)


def test_a_wait_is_told_once_and_progress_as_it_comes(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("otc_dist.launch.show.view.LINE_EVERY", 0.0)
    seen, view = board(), LineView()
    for phase, update in [("gathering", 0)] * 3 + [("evaluation", 0)] * 3 + [("evaluation", 7)] * 2:
        seen.take(status("host", phase, update=update), clock=0.0)
        view.show(seen)
    seen.take(status("host", "done"), clock=0.0)
    view.show(seen)
    view.show(seen)
    assert capsys.readouterr().out.splitlines() == [
        "host: waiting for the learners to come",
        "host: evaluation, policy 0",
        "host evaluation, policy 0 7/100 (5/s)",
        "host: done",
    ]


@pytest.mark.parametrize("width", [60, 80, 200])
def test_the_table_fits_the_terminal(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"COLUMNS": str(width), "TERM": "xterm", "NO_COLOR": "1"}.items():
        monkeypatch.setenv(name, value)
    seen, stream = board(), io.StringIO()
    told = {"alpha": 1.25, "similarity": 0.5, "return": 2532.1}
    for agent in seen.agents:
        seen.take(status(agent, "tuning", 10, update=70, **told), clock=0.0)
    seen.take(status("host", "evaluation", 10, **{"return": 2532.1}), clock=0.0)
    view = TableView("3agent_hopper")
    console = Console(file=stream, width=width)
    monkeypatch.setattr(view, "_console", console)
    console.print(view._table(seen))
    lines = stream.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    for agent in seen.agents:  # each in one line, the most telling first
        (row,) = [line for line in lines if agent in line]
        assert "tuning after deployment 10" in row and "70/100" in row
        assert ("0.500" in row) == (width == 200)


def test_a_plan_s_parts_cover_the_run_in_order() -> None:
    asked = ["engine.name=eager", "sampling.name=otc"]
    description = resolve(descriptions.load("3agent_hopper", asked, None, True))
    team = registry.team_spec(description.env.id)
    names = [(part.phase, part.deployment) for part in forecast.parts(description, team, 3)]
    assert names == [
        ("start", 0), ("offline", 0), ("dynamics", 0), ("evaluation", 0),
        ("deployment", 1), ("tuning", 1), ("evaluation", 1),
        ("deployment", 2), ("tuning", 2), ("evaluation", 2),
    ]  # fmt: skip


class _Broken(LineView):
    """A view that draws once, and then fails, as a library may."""

    def __init__(self) -> None:
        super().__init__()
        self.shown, self.left = 0, 0

    def show(self, board: Board) -> None:
        self.shown += 1
        if self.shown > 1:
            raise ZeroDivisionError("no room")

    def __exit__(self, *failure: object) -> None:
        self.left += 1


class _BrokenTable(TableView):
    def show(self, board: Board) -> None:
        raise ZeroDivisionError("no room")


def test_a_view_that_fails_is_followed_by_lines_and_ends_nothing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    seen = board()
    seen.events.append("agent_0: offline")
    with CarefulView(_BrokenTable("3agent_hopper")) as view:
        view.show(seen)
        view.show(seen)
    told = capsys.readouterr().out
    assert "the table cannot be drawn (ZeroDivisionError: no room): lines follow" in told
    assert "agent_0: offline" in told


def test_where_not_even_lines_can_be_shown_nothing_is() -> None:
    broken = _Broken()
    with CarefulView(broken) as view:
        for _ in range(3):
            view.show(board())
        view.say("a line")
    assert (broken.shown, broken.left) == (2, 1)
