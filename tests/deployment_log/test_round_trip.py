"""What was written is what is read, to the bit, from unfinished and finished logs."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from otc_dist.deployment_log.arrays import read_log
from otc_dist.deployment_log.episodes import Episode
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.reader import (
    read_header,
    read_steps,
    read_summary,
    read_transitions,
)
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.transitions import Transitions


@pytest.mark.parametrize(
    ("sizes", "copies", "steps", "state_size"),
    [
        (((11, 1),) * 3, 1, 50, 19),  # the main job
        (((17, 3),) * 2, 300, 5, 28),  # arrays longer than msgpack's smallest headers reach
        (((4, 2),) * 17, 2, 5, 0),  # more agents than fit into the smallest array header
        (((1, 1), (400, 9), (7, 3)), 4, 700, 3),  # unlike agents, several chunks
        (((3, 1),), 1, 0, 1),  # a deployment that ended before its first step
    ],
)
def test_round_trip(tmp_path: Path, recording, same, sizes, copies, steps, state_size) -> None:
    made = recording(sizes, copies, steps, state_size)
    path = tmp_path / "deployments" / "deployment_03.mcap"
    writer = made.write(path)
    for where in (path.with_name(path.name + ".partial"), path):
        if where == path:
            assert writer.finish({"agent_0": "ab"}) == path
        assert read_header(where) == made.header
        read = list(read_steps(where))
        assert len(read) == steps
        assert all(same(a, b) for a, b in zip(read, made.steps, strict=True))
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_which_deadlines_were_missed_is_read_as_it_was_written(tmp_path: Path, small, same) -> None:
    made, path = small.by_a_clock(), tmp_path / "log.mcap"
    writer = made.write(path)
    for where in (path, made.write(tmp_path / "other.mcap").finish({})):
        read = list(read_steps(where))
        assert all(same(a, b) for a, b in zip(read, made.steps, strict=True))
    writer.close()
    log = read_log(path)
    assert log.held["agent_1"].tolist() == [s.held[1] for s in made.steps for _ in range(2)]
    assert log.late.tolist() == [step.late for step in made.steps for _ in range(2)]


@pytest.mark.parametrize("timed", [False, True])
def test_a_step_that_says_of_deadlines_what_its_log_does_not_is_refused(
    tmp_path: Path, small, timed: bool
) -> None:
    other = replace(small.steps[0], held=() if timed else (False, False))
    if timed:
        small.by_a_clock()
    with pytest.raises(ValueError, match="agents whose actions were held"):
        small.write(tmp_path / "log.mcap", stop=0).write(other)


def test_an_unfinished_log_is_found_by_its_final_name(tmp_path: Path, small, same) -> None:
    path = tmp_path / "log.mcap"
    with_writer = small.write(path)
    assert sum(1 for _ in read_steps(path)) == 12
    with_writer.close()


@pytest.mark.parametrize("finished", [False, True])
def test_ranges(tmp_path: Path, recording, same, finished: bool) -> None:
    made = recording(((400, 9),) * 4, 4, 60, 3)  # 1.6 MB: several chunks
    path = tmp_path / "log.mcap"
    writer = made.write(path)
    writer.finish({}) if finished else writer.close()
    for start, stop in [(0, 1), (0, None), (59, 60), (59, 99), (60, 70), (13, 47), (5, 5), (9, 3)]:
        read = list(read_steps(path, start, stop))
        expected = made.steps[start:stop]
        assert [step.step for step in read] == [step.step for step in expected]
        assert all(same(a, b) for a, b in zip(read, expected, strict=True))


@pytest.mark.parametrize("finished", [False, True])
def test_transitions_are_those_of_the_steps(tmp_path: Path, small, finished: bool) -> None:
    path = tmp_path / "log.mcap"
    writer = small.write(path)
    writer.finish({}) if finished else writer.close()
    for index, name in enumerate(small.team.names):
        for start, stop in [(0, None), (3, 9)]:
            expected = Transitions.concatenate(
                [step.of_agent(index) for step in small.steps[start:stop]]
            )
            read = read_transitions(path, name, start, stop)
            for field in vars(expected):
                a, b = getattr(read, field), getattr(expected, field)
                assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
        assert len(read_transitions(path, name, 5, 5)) == 0


def test_read_arrays_can_be_written_to(tmp_path: Path, small) -> None:
    path = small.finish(tmp_path / "log.mcap")
    for step in read_steps(path):
        for array in (*step.observations, step.terminated, step.state):
            assert array.flags.writeable and array.flags.aligned


def test_the_summary_tells_policies_and_episodes(tmp_path: Path, recording) -> None:
    made = recording(((2, 1),) * 2, 2, 40)
    path = tmp_path / "log.mcap"
    writer = made.write(path)
    unfinished = read_summary(path)
    writer.finish({"agent_0": "aa", "agent_1": "bb"})
    summary = read_summary(path)

    assert (unfinished.extent.finished, unfinished.policies) == (False, {})
    assert (summary.extent.finished, summary.policies) == (True, {"agent_0": "aa", "agent_1": "bb"})
    assert (summary.steps, unfinished.steps) == (40, 40)
    assert summary.episodes == unfinished.episodes == _episodes_by_hand(made)
    assert any(not e.terminated and not e.truncated for e in summary.episodes)  # cut by the end
    assert any(e.terminated for e in summary.episodes) and any(
        e.truncated for e in summary.episodes
    )


def _episodes_by_hand(made) -> list[Episode]:
    done, running = [], {}
    for step in made.steps:
        for copy in range(made.header.copies):
            episode = running.get(copy) or Episode(
                int(step.episode_seeds[copy]), copy, step.step, 0, (0.0, 0.0), False, False
            )
            running[copy] = replace(
                episode,
                length=episode.length + 1,
                returns=tuple(
                    total + float(reward[copy])
                    for total, reward in zip(episode.returns, step.rewards, strict=True)
                ),
                terminated=bool(step.terminated[copy]),
                truncated=bool(step.truncated[copy]),
            )
            if step.terminated[copy] or step.truncated[copy]:
                done.append(running.pop(copy))
    done.extend(running.values())
    return [
        replace(e, returns=tuple(pytest.approx(r, abs=1e-12) for r in e.returns))
        for e in sorted(done, key=lambda e: (e.start, e.copy))
    ]


def test_payloads_do_not_depend_on_when_they_were_written(tmp_path: Path, small) -> None:
    from mcap.reader import make_reader

    def payloads(path: Path) -> list[tuple[int, bytes]]:
        with path.open("rb") as stream:
            return [
                (message.sequence, message.data)
                for _, _, message in make_reader(stream).iter_messages("joint_step")
            ]

    first = payloads(small.finish(tmp_path / "a" / "log.mcap"))
    second = payloads(small.finish(tmp_path / "b" / "log.mcap"))
    assert len(first) == 12 and first == second


def test_the_order_of_times_is_the_order_of_steps(
    tmp_path: Path, small, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the system's clock is set back while we record."""
    from mcap.reader import make_reader

    times = iter([10**18, 10**18, 5, *range(10**18, 10**18 + 9)])
    monkeypatch.setattr("otc_dist.deployment_log.writer.time.time_ns", lambda: next(times))
    path = small.finish(tmp_path / "log.mcap")
    with path.open("rb") as stream:
        messages = make_reader(stream).iter_messages("joint_step")
        found = [(message.log_time, message.sequence) for _, _, message in messages]
    assert [sequence for _, sequence in found] == list(range(12))
    assert all(a < b for (a, _), (b, _) in pairwise(found))


@pytest.mark.parametrize(
    "change",
    [
        lambda s: replace(s, step=s.step + 1),
        lambda s: replace(s, rewards=tuple(r[:1] for r in s.rewards)),
        lambda s: replace(s, rewards=s.rewards[:1]),
        lambda s: replace(s, exploring=(True,)),
        lambda s: replace(s, episode_seeds=s.episode_seeds.astype(np.int32)),
        lambda s: replace(s, observations=tuple(o.astype(np.float64) for o in s.observations)),
    ],
)
def test_a_step_of_another_team_is_refused(tmp_path: Path, small, same, change: Callable) -> None:
    """And the log goes on as if it had not been tried."""
    writer = LogWriter.create(tmp_path / "log.mcap", small.header)
    writer.write(small.steps[0])
    with pytest.raises((ValueError, TypeError)):
        writer.write(change(small.steps[1]))
    writer.write(small.steps[1])
    writer.close()
    read = list(read_steps(writer.path))
    assert len(read) == 2 and all(same(a, b) for a, b in zip(read, small.steps, strict=False))


def test_the_header_keeps_all_of_the_team(small) -> None:
    agent = replace(
        small.team.agents[0], observation_size=8, action_low=(0.0,), action_high=(4.0,), choices=5
    )
    header = replace(small.header, team=replace(small.team, agents=(agent,)))
    assert LogHeader.from_entries(header.to_entries(), Path("log")) == header
