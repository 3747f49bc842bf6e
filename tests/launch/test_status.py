"""What `launch status` prints of the processes."""

from otc_dist.launch.show.process_states import ProcessState
from otc_dist.launch.show.status import _table


def state(phase: str, done: int, of: int, restarts: int = 0, last_end: str = "") -> ProcessState:
    return ProcessState("up", 1.0, 123456, restarts, last_end, phase, 10, done, of, 5.0, {})


def test_the_table_is_no_wider_than_the_terminal() -> None:
    processes = {"host": state("evaluation", 120, 1000), "agent_0": state("tuning", 7, 9)}
    assert list(_table(processes, 80)) == [
        "process  pid     health  does                        done",
        "host     123456  up      evaluation, policy 10       120/1,000",
        "agent_0  123456  up      tuning after deployment 10  7/9",
    ]
    assert list(_table(processes, 60)) == [
        "process  health  does                        done",
        "host     up      evaluation, policy 10       120/1,000",
        "agent_0  up      tuning after deployment 10  7/9",
    ]


def test_who_was_started_again_is_told_with_how_it_ended() -> None:
    found = list(_table({"host": state("done", 0, 0, 2, "was killed by SIGKILL")}, 80))
    assert found[0].split()[3] == "restarts" and found[1].split()[3] == "2"
    assert found[2] == "  its last end: was killed by SIGKILL"
