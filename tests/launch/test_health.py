"""What tokens, statuses and ends say of processes: who is well, who is lost, who starts again."""

from pathlib import Path

import pytest

from otc_dist.bus.messages import Status
from otc_dist.launch.supervise.health import (
    FIRST_DELAY,
    FROZEN_AFTER,
    LASTING,
    LEAVING,
    LIMIT,
    REPORT_AFTER,
    Health,
)
from otc_dist.launch.supervise.supervisor import End

DEADLINE = 30.0
KILLED = {name: End(name, -9, None) for name in ("host", "agent_0")}


def at_rest(pid: int) -> int:
    """Processor time that does not grow."""
    return 1


@pytest.fixture
def health() -> Health:
    """Host and agent_0 are up at 0 s."""
    made = Health(("host", "agent_0"), DEADLINE, host_is_router=True)
    made.take_link(True, 0.0)
    for pid, name in enumerate(("host", "agent_0"), 100):
        made.started(name, pid, 0.0)
        made.take_token(name, True, 0.0)
    return made


def states(health: Health) -> list[str]:
    return [process.state for process in health.of_process.values()]


def test_a_process_is_up_when_its_token_is_there() -> None:
    health = Health(("host", "agent_0"), DEADLINE, host_is_router=True)
    health.started("host", 100, 0.0)
    assert states(health) == ["starting", "starting"]
    health.take_token("host", True, 1.0)
    health.take_token("somebody else", True, 1.0)
    assert states(health) == ["up", "starting"]


def test_a_silent_process_that_does_nothing_is_frozen(health: Health) -> None:
    health.take_token("agent_0", False, 1.0)
    assert health.lost(1.0, at_rest) == {} and health.events == []
    assert health.lost(1.0 + REPORT_AFTER, at_rest) == {}
    assert health.events == ["agent_0: is silent"]
    assert health.lost(1.0 + FROZEN_AFTER, at_rest) == {"agent_0": "is frozen"}


def test_a_silent_process_that_works_is_not_lost(health: Health) -> None:
    health.take_token("agent_0", False, 1.0)
    for second in range(1, 20):
        assert health.lost(float(second), lambda _, used=second: used) == {}  # type: ignore[misc]


def test_where_no_processor_time_is_known_silence_counts_alone(health: Health) -> None:
    health.take_token("agent_0", False, 1.0)
    health.lost(1.0, lambda _: None)
    assert health.lost(1.0 + FROZEN_AFTER, lambda _: None) == {"agent_0": "is frozen"}


def test_a_process_that_is_back_is_well(health: Health) -> None:
    health.take_token("agent_0", False, 1.0)
    assert health.lost(1.0 + REPORT_AFTER, at_rest) == {}
    health.take_token("agent_0", True, 3.5)
    assert health.lost(10.0, at_rest) == {}
    assert health.events == ["agent_0: is silent", "agent_0: is back"]


def test_a_short_silence_is_not_worth_a_line(health: Health) -> None:
    health.take_token("agent_0", False, 1.0)
    health.lost(0.9 + REPORT_AFTER, at_rest)
    health.take_token("agent_0", True, 0.9 + REPORT_AFTER)
    health.lost(9.0, at_rest)
    assert health.events == []


def test_when_all_is_done_nobody_is_called_silent(health: Health) -> None:
    """Nor where the env host is on another machine."""
    apart = Health(("agent_0",), DEADLINE, host_is_router=True)
    apart.take_token("host", True, 0.0)
    apart.started("agent_0", 100, 0.0)
    apart.take_token("agent_0", True, 0.0)
    for one in (health, apart):
        one.take(Status("agent_0", "ready", 2), 1.0)
        one.take(Status("host", "done", 2), 1.0)
        one.take_token("agent_0", False, 1.0)
        one.lost(1.0 + REPORT_AFTER, lambda pid: None)
        one.take_token("agent_0", True, 1.5 + REPORT_AFTER)
        assert one.events == []


def test_with_the_host_all_tokens_go_and_it_alone_is_called_silent(health: Health) -> None:
    for name in ("host", "agent_0"):
        health.take_token(name, False, 1.0)
    health.lost(1.0 + REPORT_AFTER, at_rest)
    assert health.events == ["host: is silent"]


def test_without_the_host_only_the_host_is_judged(health: Health) -> None:
    """It carries the bus: the others' tokens went with it."""
    for name in ("host", "agent_0"):
        health.take_token(name, False, 1.0)
    health.lost(1.0, at_rest)
    assert health.lost(1.0 + FROZEN_AFTER, at_rest) == {"host": "is frozen"}
    health.take_token("host", True, 9.0)
    assert health.lost(9.0, at_rest) == {}
    assert health.lost(9.0 + FROZEN_AFTER, at_rest) == {"agent_0": "is frozen"}


def test_behind_a_router_nobody_is_judged_while_the_link_is_cut(health: Health) -> None:
    routed = Health(("host",), DEADLINE, host_is_router=False)
    routed.started("host", 100, 0.0)
    routed.take_link(True, 0.0)
    routed.take_token("host", True, 0.0)
    routed.take_token("host", False, 1.0)
    routed.take_link(False, 1.0)
    routed.lost(1.0, at_rest)
    assert routed.lost(20.0, at_rest) == {}
    routed.take_link(True, 20.0)
    routed.lost(20.0, at_rest)
    assert routed.lost(20.0 + FROZEN_AFTER, at_rest) == {"host": "is frozen"}


def test_a_busy_process_without_progress_is_lost_whatever_its_heartbeat_says(
    health: Health,
) -> None:
    for second in range(0, 40, 10):
        health.take(Status("agent_0", "tuning", 1, 7, 100), float(second))
        health.take(Status("host", "deployment", 1, 3, 100, awaits=("agent_0",)), float(second))
    why = f"has made no progress for {DEADLINE:g} s"
    assert health.lost(DEADLINE, at_rest) == {"agent_0": why}  # the host waits: it is not busy
    health.take(Status("agent_0", "tuning", 1, 8, 100), DEADLINE)
    assert health.lost(DEADLINE + 1, at_rest) == {}


def hear(health: Health, until: float, *statuses: Status) -> None:
    """Say the same twice a second, up to and with the second `until`, and judge each time."""
    clock = max(process.heard for process in health.of_process.values())
    while clock < until:
        clock += 0.5
        for status in statuses:
            health.take(status, clock)
        if clock < until:
            assert health.lost(clock, at_rest) == {}


READY = Status("agent_0", "ready", 1)
NO_PROGRESS = f"has made no progress for {DEADLINE:g} s"


@pytest.mark.parametrize("phase", ["starting", "evaluation", "deployment"])
def test_an_env_host_that_waits_for_nobody_and_stands_still_is_lost(
    health: Health, phase: str
) -> None:
    hear(health, DEADLINE + 0.5, Status("host", phase, 1, 7, 100), READY)
    assert health.lost(DEADLINE + 0.5, at_rest) == {"host": NO_PROGRESS}


def test_an_agent_whose_answer_the_host_waits_for_is_lost_and_no_other(health: Health) -> None:
    asking = Status("host", "deployment", 2, 7, 100, awaits=("agent_0",))
    hear(health, 20.0, Status("host", "deployment", 2, 6, 100, awaits=("agent_0",)), READY)
    hear(health, 20.0 + DEADLINE, asking, READY)  # it answered the question before
    assert health.lost(20.0 + DEADLINE, at_rest) == {}
    hear(health, 20.5 + DEADLINE, asking, READY)
    why = f"has given the env host no answer for {DEADLINE:g} s"
    assert health.lost(20.5 + DEADLINE, at_rest) == {"agent_0": why}
    assert health.lost(21.5 + DEADLINE, at_rest) == {}  # it is being killed
    health.died(KILLED["agent_0"], 22.0 + DEADLINE)
    assert health.of_process["agent_0"].last_end == f"was killed by SIGKILL, since it {why}"


def test_of_answers_that_cannot_be_taken_it_is_said_why(health: Health) -> None:
    before = {"rejected/stale": 3.0, "rejected/not-finite": 1.0}
    health.take(Status("host", "deployment", 1, 6, 100, metrics=before), 0.0)
    now = before | {"rejected/not-finite": 40.0}
    hear(
        health,
        DEADLINE + 0.5,
        Status("host", "deployment", 1, 7, 100, metrics=now, awaits=("agent_0",)),
        READY,
    )
    (why,) = health.lost(DEADLINE + 0.5, at_rest).values()
    assert why.endswith("that it could take (not-finite 39 rejected)")


def test_a_host_that_has_waited_long_is_judged_from_when_it_works_again(health: Health) -> None:
    training = [Status("agent_0", "tuning", 1, update, 1000) for update in range(200)]
    for update, status in enumerate(training):
        health.take(Status("host", "evaluation", 1, 0, 9, awaits=("agent_0",)), update / 2)
        health.take(status, update / 2)
        assert health.lost(update / 2, at_rest) == {}
    hear(health, 99.5 + DEADLINE, Status("host", "evaluation", 1, 0, 9), READY)
    assert health.lost(99.5 + DEADLINE, at_rest) == {}
    hear(health, 100.0 + DEADLINE, Status("host", "evaluation", 1, 0, 9), READY)
    assert health.lost(100.0 + DEADLINE, at_rest) == {"host": NO_PROGRESS}


def test_whom_a_host_waits_for_that_says_nothing_any_more_is_not_held_against_others(
    health: Health,
) -> None:
    """Its thread that tells is stuck with it, as in code that never lets go of the interpreter."""
    health.take(Status("host", "deployment", 1, 7, 100, awaits=("agent_0",)), 0.0)
    hear(health, DEADLINE, READY)
    assert health.lost(DEADLINE, at_rest) == {"host": f"has said nothing for {DEADLINE:g} s"}
    health.take(READY, DEADLINE + 10)
    assert health.lost(DEADLINE + 10, at_rest) == {}


@pytest.mark.parametrize("phase", ["gathering", "approval", "reset"])
def test_who_waits_for_others_or_for_a_person_is_not_judged(health: Health, phase: str) -> None:
    hear(health, 10 * DEADLINE, Status("host", phase, 1), Status("agent_0", "waiting"))
    assert health.lost(10 * DEADLINE, at_rest) == {}


def test_who_waited_long_for_the_host_has_all_its_time_to_start(health: Health) -> None:
    hear(health, 100.0, Status("host", "gathering"), Status("agent_0", "waiting"))
    hear(health, 100.0 + DEADLINE, Status("host", "gathering"), Status("agent_0", "starting"))
    assert health.lost(100.0 + DEADLINE, at_rest) == {}


def test_who_is_done_and_does_not_end_is_lost(health: Health) -> None:
    patience = max(DEADLINE, LEAVING)
    hear(health, patience + 0.5, Status("host", "done", 2), Status("agent_0", "ready", 2))
    assert health.lost(patience + 0.5, at_rest) == {
        "host": f"has made no progress for {patience:g} s"
    }


def test_a_host_that_never_listens_is_lost_though_nothing_can_be_heard() -> None:
    health = Health(("host", "agent_0"), DEADLINE, host_is_router=True)
    for name in ("host", "agent_0"):
        health.started(name, 100, 0.0)
    assert health.lost(DEADLINE - 1, at_rest) == {}
    assert health.lost(DEADLINE, at_rest) == {"host": f"has not come for {DEADLINE:g} s"}


def test_who_is_kept_from_running_while_it_starts_is_not_stuck(health: Health) -> None:
    """On a machine that is busy, importing a library alone may take longer than the deadline."""
    kept = {100: 0.0, 101: 0.0}
    for second in range(100):
        kept[101] = 0.9 * second
        health.take(Status("host", "gathering"), float(second))
        health.take(Status("agent_0", "starting"), float(second))
        assert health.lost(float(second), at_rest, kept.__getitem__) == {}


def test_time_in_which_others_kept_a_process_from_running_does_not_count(health: Health) -> None:
    kept: dict[int, float] = {100: 0.0, 101: 0.0}
    asking = Status("host", "deployment", 1, 7, 100, awaits=("agent_0",))
    for second in range(100):
        kept[101] = 0.9 * second
        for status in (asking, READY):
            health.take(status, float(second))
        assert health.lost(float(second), at_rest, kept.__getitem__) == {}
    for second in range(100, 130):
        for status in (asking, READY):
            health.take(status, float(second))
        if health.lost(float(second), at_rest, kept.__getitem__):
            break
    assert second == 120  # 10 s of the first 100 were its own


def test_delays_double_and_end_after_the_limit(health: Health) -> None:
    delays = []
    for restart in range(LIMIT):
        delays.append(health.died(KILLED["agent_0"], 1.0 + restart))
        health.started("agent_0", 200 + restart, 1.0 + restart)
    assert delays == [FIRST_DELAY * 2**n for n in range(LIMIT)]
    assert health.died(KILLED["agent_0"], 9.0) is None
    assert health.of_process["agent_0"].restarts == LIMIT
    assert health.of_process["agent_0"].last_end == "was killed by SIGKILL"


def test_progress_or_a_minute_of_work_make_the_next_restart_the_first(health: Health) -> None:
    health.died(KILLED["agent_0"], 1.0)
    health.started("agent_0", 200, 1.0)
    assert health.died(KILLED["agent_0"], 2.0) == 2 * FIRST_DELAY
    health.started("agent_0", 201, 2.0)
    health.take(Status("agent_0", "offline", 0, 100, 1000), 3.0)
    assert health.died(KILLED["agent_0"], 4.0) == FIRST_DELAY
    health.started("agent_0", 202, 4.0)
    health.take(Status("agent_0", "offline", 0, 50, 1000), 4.0 + LASTING)  # behind, yet at work
    assert health.died(KILLED["agent_0"], 5.0 + LASTING) == FIRST_DELAY


def test_a_minute_of_waiting_is_no_work(health: Health) -> None:
    """The host ends when an answer is overdue, which takes longer than a minute."""
    clock, delays = 0.0, []
    for _ in range(LIMIT + 1):
        health.started("agent_0", 200, clock)
        health.take(Status("agent_0", "offline", 0, 50, 1000), clock + 1.0)
        clock += 2 * LASTING
        delays.append(health.died(KILLED["agent_0"], clock))
    assert delays[-1] is None


def test_a_restart_tells_what_the_process_said_last(health: Health, tmp_path: Path) -> None:
    (tmp_path / "log").write_text("all is well\nno answer from agent_1 for 120 s\n")
    health.died(End("agent_0", 1, tmp_path / "log"), 1.0)
    (event,) = health.events
    assert "exited with status 1 (no answer from agent_1 for 120 s); starts again" in event


def test_catching_up_is_no_progress(health: Health) -> None:
    health.take(Status("agent_0", "offline", 0, 500, 1000), 1.0)
    health.died(KILLED["agent_0"], 1.0)
    health.started("agent_0", 200, 2.0)
    health.take(Status("agent_0", "offline", 0, 400, 1000), 3.0)
    assert health.died(KILLED["agent_0"], 4.0) == 2 * FIRST_DELAY
