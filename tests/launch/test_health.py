"""What tokens, statuses and ends say of processes: who is well, who is lost, who starts again."""

from pathlib import Path

import pytest

from otc_dist.bus.messages import Status
from otc_dist.launch.health import FIRST_DELAY, FROZEN_AFTER, LASTING, LIMIT, TELL_AFTER, Health
from otc_dist.launch.supervisor import End

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
    return [life.state for life in health.lives.values()]


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
    assert health.lost(1.0 + TELL_AFTER, at_rest) == {}
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
    assert health.lost(1.0 + TELL_AFTER, at_rest) == {}
    health.take_token("agent_0", True, 3.5)
    assert health.lost(10.0, at_rest) == {}
    assert health.events == ["agent_0: is silent", "agent_0: is back"]


def test_a_short_silence_is_not_worth_a_line(health: Health) -> None:
    health.take_token("agent_0", False, 1.0)
    health.lost(0.9 + TELL_AFTER, at_rest)
    health.take_token("agent_0", True, 0.9 + TELL_AFTER)
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
        one.lost(1.0 + TELL_AFTER, lambda pid: None)
        one.take_token("agent_0", True, 1.5 + TELL_AFTER)
        assert one.events == []


def test_with_the_host_all_tokens_go_and_it_alone_is_called_silent(health: Health) -> None:
    for name in ("host", "agent_0"):
        health.take_token(name, False, 1.0)
    health.lost(1.0 + TELL_AFTER, at_rest)
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
        health.take(Status("host", "deployment", 1, 3, 100), float(second))
    why = f"has made no progress for {DEADLINE:g} s"
    assert health.lost(DEADLINE, at_rest) == {"agent_0": why}  # the host waits: it is not busy
    health.take(Status("agent_0", "tuning", 1, 8, 100), DEADLINE)
    assert health.lost(DEADLINE + 1, at_rest) == {}


def test_delays_double_and_end_after_the_limit(health: Health) -> None:
    delays = []
    for restart in range(LIMIT):
        delays.append(health.died(KILLED["agent_0"], 1.0 + restart))
        health.started("agent_0", 200 + restart, 1.0 + restart)
    assert delays == [FIRST_DELAY * 2**n for n in range(LIMIT)]
    assert health.died(KILLED["agent_0"], 9.0) is None
    assert health.lives["agent_0"].restarts == LIMIT
    assert health.lives["agent_0"].last_end == "was killed by SIGKILL"


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
