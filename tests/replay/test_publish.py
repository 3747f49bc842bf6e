"""`--publish` without learners: any listener sees what was, as it was, when it is due."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgpack
import numpy as np
import pytest

from otc_dist.bus.codec import AgentCodec
from otc_dist.bus.endpoints import Endpoint, local_endpoint
from otc_dist.bus.keys import HOST
from otc_dist.bus.messages import Moment, Status, decode_status
from otc_dist.bus.session import Session
from otc_dist.deployment_log.reader import (
    read_header,
    read_steps,
    read_summary,
    read_transitions,
)
from otc_dist.description import Description
from otc_dist.replay import publish
from otc_dist.replay.__main__ import main
from otc_dist.replay.busy_learners import BusyLearners
from otc_dist.replay.selection import Selection
from otc_dist.terminal.errors import UserError

from .deployments import logged, played, retold


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return played(tmp_path_factory.mktemp("published") / "log.mcap", "navigation", steps=60, k=1)


def heard(log: Path, run: Path, *arguments: str) -> dict[str, list[bytes]]:
    """What somebody hears who listens to all of the run: questions, answers, statuses."""
    command = [sys.executable, "-m", "otc_dist.replay", str(log), "--publish", "--run", str(run)]
    found: dict[str, list[bytes]] = {"question": [], "answer": [], "status": []}

    def receive(payload: bytes) -> None:
        fields = msgpack.unpackb(payload)
        kind = "status" if isinstance(fields[3], str) else "question"
        found["answer" if kind == "question" and len(fields) == 9 else kind].append(payload)

    with (
        subprocess.Popen([*command, *arguments], stderr=subprocess.PIPE, text=True) as publisher,
        Session.connect(Endpoint(local_endpoint(run)), 16_000, timeout=60) as session,
    ):
        # One subscription: the publisher begins as soon as there is any.
        session.subscribe(f"otc/{read_header(log).run}/*/*/*", receive)
        assert publisher.stderr is not None
        output = publisher.stderr.read()
        assert publisher.wait(60) == 0, output
    return found


def test_questions_answers_and_statuses_are_those_of_the_log(log: Path, tmp_path: Path) -> None:
    found = heard(log, tmp_path / "run", "--rate", "100000")
    header, steps = read_header(log), list(read_steps(log))
    codec = AgentCodec(header.run, header.team.agents[0], {"deployment": 2})
    questions = [codec.decode_observation(payload) for payload in found["question"]]
    epoch = questions[0].moment.epoch
    assert [q.moment for q in questions] == [
        Moment("deployment", 1, epoch, t) for t in range(len(steps))
    ]
    for question, step in zip(questions, steps, strict=True):
        assert question.observations is not None
        assert question.observations.tobytes() == step.observations[0].tobytes()
    for question, before in zip(questions[1:], steps, strict=False):
        assert question.outcome is not None
        assert question.outcome.rewards.tobytes() == before.rewards[0].tobytes()
        seen = question.outcome.next_observations
        assert seen.tobytes() == before.next_observations[0].tobytes()
        assert np.array_equal(question.outcome.truncated, before.truncated)
    assert len(found["answer"]) == len(steps)
    for question, step, payload in zip(questions, steps, found["answer"], strict=True):
        answer = codec.decode_action(payload, question.moment, acting=True)
        assert answer.actions is not None and answer.policy == "0" * 16
        assert answer.actions.tobytes() == step.actions[0].tobytes()
    last = decode_status(found["status"][-1], header.run, HOST)
    assert (last.phase, last.deployment, last.update, last.total) == ("deployment", 1, 59, 60)


def test_a_part_is_published_when_asked_for(log: Path, tmp_path: Path) -> None:
    found = heard(log, tmp_path / "run", "--rate", "100000", "--steps", "20:25")
    header = read_header(log)
    codec = AgentCodec(header.run, header.team.agents[0], {"deployment": 2})
    steps = [codec.decode_observation(payload).moment.step for payload in found["question"]]
    assert steps == [21, 22, 23, 24]  # what the question of step 20 would tell is not selected
    assert len(found["answer"]) == 5


@pytest.mark.parametrize("rate", [1.0, 10.0])
def test_steps_are_due_as_they_were_recorded(
    log: Path, monkeypatch: pytest.MonkeyPatch, rate: float
) -> None:
    now = [0.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds

    monkeypatch.setattr(publish.time, "sleep", sleep)
    monkeypatch.setattr(publish.time, "monotonic", lambda: now[0])
    summary = read_summary(log)
    assert summary.times is not None
    first, last = summary.times
    given = []
    for step in publish._steps(summary, Selection(0, summary.end, ("agent_0",)), rate):
        given.append((step.step, now[0]))
    assert [step for step, _ in given] == list(range(60))
    assert given[0][1] == 0 and given[-1][1] == pytest.approx((last - first) / 1e9 / rate)


def test_a_gap_of_the_log_s_clock_is_told_and_not_waited_for(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As after a stop for the night, or where somebody set the clock."""
    now, jumps = [0.0], iter([*range(0, 10), *range(86_400 + 9, 86_400 + 59)])
    with monkeypatch.context() as recording:
        recording.setattr(
            "otc_dist.deployment_log.writer.time.time_ns", lambda: next(jumps) * 10**9
        )
        jumped = logged(tmp_path / "jumped.mcap", read_header(log), read_steps(log))
    monkeypatch.setattr(publish.time, "sleep", lambda seconds: now.append(now.pop() + seconds))
    monkeypatch.setattr(publish.time, "monotonic", lambda: now[0])
    summary = read_summary(jumped)
    given = list(publish._steps(summary, Selection(0, summary.end, ("agent_0",)), 10.0))
    assert len(given) == 60
    assert now[0] == pytest.approx((58 + publish.LONGEST_GAP) / 10)
    output = capsys.readouterr().err
    assert "the log's clock jumped by 86,400 s before step 10: waiting 5 s instead" in output


Refused = Callable[..., str]


@pytest.mark.parametrize(("there", "gone"), [(True, ""), (False, ", a folder that is not there")])
def test_it_says_for_what_it_waits_and_how_long(
    log: Path,
    tmp_path: Path,
    refused: Refused,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    there: bool,
    gone: str,
) -> None:
    run, now = tmp_path / "run", [0.0]
    if there:
        run.mkdir()
    monkeypatch.setattr(publish.time, "sleep", lambda seconds: now.append(now.pop() + seconds))
    monkeypatch.setattr(publish.time, "monotonic", lambda: now[0])
    message = refused(log, "--publish", "--run", run)
    assert message == f"nobody listened on the bus of {run} for 120 s"
    first, *lines = capsys.readouterr().err.splitlines()
    assert first.startswith("waiting up to 2 min 00 s for somebody to listen on the bus of")
    assert f" {run}{gone}: to otc/" in first
    assert lines[:2] == [f"waiting for somebody to listen: {n} of 120 s" for n in (10, 20)]
    assert lines[-1] == "waiting for somebody to listen: 120 of 120 s"


def test_it_says_how_long_it_waits_for_learners_too(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = Description.parse(read_header(log).description, source="")
    hasty = found.with_assignments("bus.answer_deadline=1")
    about = {"description": hasty.to_toml(), "description_digest": hasty.digest()}
    other = retold(log, tmp_path / "log.mcap", **about)
    command = [str(other), "--publish", "--learners", "--run", str(tmp_path / "run")]
    assert main(command) == 1
    first, *lines = capsys.readouterr().err.splitlines()
    assert first.startswith("waiting up to 1 s for the learners of agent_0; each is started by")
    assert lines[0] == "waiting for the learners: 1 of 1 s"
    assert lines[-1] == "error: waited 1 s for agent_0 to come"


def test_what_a_learner_is_busy_with_is_said_when_it_begins_and_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now, said = [0.0], BusyLearners()
    monkeypatch.setattr(publish.time, "monotonic", lambda: now[0])
    for now[0], phase, update in (
        *((0.0, "starting", 0), (1.0, "offline", 0), (2.0, "offline", 9), (11.5, "offline", 99)),
        *((12.0, "ready", 0), (30.0, "ready", 0), (31.0, "tuning", 5)),
    ):
        said(Status("agent_1", phase, 0, update, 1000 if update else 0))
    assert capsys.readouterr().err.splitlines() == [
        "agent_1: starting",
        "agent_1: offline",
        "agent_1: offline, 99 of 1,000 updates",
        "agent_1: tuning, 5 of 1,000 updates",
    ]


def test_mistakes_are_one_line(log: Path, tmp_path: Path, refused: Refused) -> None:
    other = retold(log, tmp_path / "b.mcap", run="another-run", deployment=2)
    assert "of several runs" in refused(log, other, "--publish")
    needs = "--learners needs --run DIR"
    assert needs in refused(log, "--publish", "--learners")
    learners = ("--publish", "--learners", "--run", tmp_path / "run")
    assert "whole deployments" in refused(log, *learners, "--steps", "3:")
    own = tmp_path / "run" / "deployments" / "a.mcap"
    own.parent.mkdir(parents=True)
    assert "the run that these logs are of" in refused(retold(log, own), *learners)
    shutil.rmtree(tmp_path / "run")
    second = retold(log, tmp_path / "c.mcap", deployment=2)
    assert "the log of deployment 1 is not at hand" in refused(second, *learners)
    (tmp_path / "run").mkdir(exist_ok=True)
    header = read_header(log)
    text = header.description.replace("seed = 0", "seed = 1")
    (tmp_path / "run" / "description.toml").write_text(text)
    assert "the folder of another run" in refused(log, *learners)
    (tmp_path / "run" / "description.toml").rename(tmp_path / "run" / "run.json")
    assert "holds something else" in refused(log, *learners)
    assert (tmp_path / "run" / "run.json").read_text() == text


def test_learners_are_not_given_a_deployment_with_gaps(
    log: Path, tmp_path: Path, refused: Refused
) -> None:
    header = replace(read_header(log), versions={"otc_dist": "0"})
    short = logged(tmp_path / "a.mcap", header, list(read_steps(log))[:30])
    message = refused(short, "--publish", "--learners", "--run", tmp_path / "run")
    assert "does not hold its whole deployment" in message


def test_learners_are_told_of_deployments_whose_logs_lie_beside(log: Path, tmp_path: Path) -> None:
    """One that begins with a later deployment asks for its history first."""
    header = read_header(log)
    first, second = (retold(log, tmp_path / f"deployment_0{k}.mcap", deployment=k) for k in (1, 2))
    read = publish._Logs({2: second}, header).of_agent("agent_0")
    own = read_transitions(first, "agent_0", 3, 9)
    assert read(1, 3, 9).next_observations.tobytes() == own.next_observations.tobytes()
    with pytest.raises(UserError, match="steps 50 to 69 are not all in the log"):
        read(1, 50, 70)
    first.unlink()
    retold(log, first, deployment=1, run="another-run")
    with pytest.raises(UserError, match="the log of deployment 1 is not at hand"):
        read(1, 3, 9)
