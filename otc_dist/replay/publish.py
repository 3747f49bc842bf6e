"""`--publish`: logs of a run on the bus again, under its keys.

Whoever listens sees the deployments as they were, at their own pace or `--rate` times as fast. With
`--learners`, the agents' learners are asked, as fast as the slowest answers, and tune as they did.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from otc_dist.bus.agreement import longest_message
from otc_dist.bus.endpoints import Endpoint, local_endpoint, remove_local_endpoint
from otc_dist.bus.history import Read
from otc_dist.bus.keys import HOST
from otc_dist.bus.lockstep import GaveUpError
from otc_dist.bus.session import Session
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import (
    LogSummary,
    read_header,
    read_summary,
    read_transitions,
)
from otc_dist.deployment_log.several import in_order
from otc_dist.description import Description, user_code
from otc_dist.replay.busy_learners import BusyLearners
from otc_dist.replay.log_host import AnswerChecker, LogHost, LogPublisher, OtherActionError
from otc_dist.replay.output import note_shortfall
from otc_dist.replay.selection import Selection, select
from otc_dist.run.folder import RunFolder
from otc_dist.run.host_state import HostState
from otc_dist.terminal.amounts import duration
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import say
from otc_dist.terminal.progress import shown
from otc_dist.transitions import JointStep, Transitions

_Part = tuple[LogSummary, Selection]

_LOOK = 0.02  # seconds between two looks at whether somebody listens
LONGEST_GAP = 5.0  # seconds of a log's own time between two steps that are waited for


def run(arguments: argparse.Namespace) -> int:
    """Publish the logs in order of their deployments.

    Returns 1 if a learner acts differently from the log, or shows no sign of life any more.

    Raises:
        UserError: logs of several runs, or with steps missing for learners; nobody listens; ...
    """
    headers = {path: read_header(path) for path in arguments.files}
    paths = in_order(headers)
    first = headers[paths[0]]
    runs = {(header.run, header.description_digest) for header in headers.values()}
    if len(runs) > 1:
        raise UserError("the logs are of several runs: publish one at a time")
    # Of the last, which describes all deployments, should the run have been extended.
    last = headers[paths[-1]].description
    description = Description.parse(last, source=f"the description in {paths[-1]}")
    summaries = [read_summary(path) for path in paths]
    for summary in summaries:
        note_shortfall(summary)
    parts = [(summary, select(arguments, summary)) for summary in summaries]
    root = arguments.run or paths[0].resolve().parent.parent
    logs = _Logs({headers[path].deployment: path for path in paths}, first)
    if arguments.learners:
        _prepare_learners(arguments, parts, description, logs)
    indices = parts[0][1].indices(first.team.names)
    epoch = HostState.begin(RunFolder(arguments.run)).epoch if arguments.learners else 1
    with _centre(root, longest_message(description, first.team)) as session:
        host = LogHost(session, first, description, indices, logs.of_agent, epoch)
        try:
            if arguments.learners:
                _ask(arguments, host, parts)
            else:
                _publish(arguments, host, parts, root)
        except (GaveUpError, OtherActionError) as error:
            say(f"error: {error}", file=sys.stderr)
            return 1
    return 0


def _publish(arguments: argparse.Namespace, host: LogHost, parts: list[_Part], root: Path) -> None:
    publisher = LogPublisher(host)
    _wait_for_somebody(host, root)
    with host:
        for summary, selection in parts:
            steps = _steps(summary, selection, arguments.rate or 1.0)
            publisher.publish(summary.header.deployment, summary.end, steps, summary.policies)


def _ask(arguments: argparse.Namespace, host: LogHost, parts: list[_Part]) -> None:
    say(
        f"waiting up to {duration(host.deadline)} for the learners of {', '.join(host.names)}; each"
        f" is started by python -m otc_dist.services.learner --run {arguments.run} --agent NAME",
        file=sys.stderr,
    )
    checker = AnswerChecker(host, BusyLearners())
    with host:
        with shown("waiting for the learners", "s") as report:
            checker.wait_for_learners(lambda waited: report(int(waited), int(host.deadline)))
        for summary, selection in parts:
            steps = _steps(summary, selection, arguments.rate)
            checker.ask(summary.header.deployment, summary.end, steps, summary.policies)
        checker.end(parts[-1][0].header.deployment)


def _steps(summary: LogSummary, selection: Selection, rate: float | None) -> Iterator[JointStep]:
    """The selected steps, each when it is due: `rate` times as fast as logged, or at once.

    What a log's clock skipped while the run was stopped, or when it was set, is not waited for.
    """
    doing = f"publishing deployment {summary.header.deployment}"
    total = selection.stop - selection.start
    due, before, done = time.monotonic(), None, 0
    with OpenLog(summary.path) as log, shown(doing, "steps") as report:
        for rows in log.blocks(selection.start, selection.stop):
            for row, step in zip(rows, log.layout.steps(rows), strict=True):
                logged = int(row["log_time"])
                gap = 0.0 if before is None else (logged - before) / 1e9
                before = logged
                if rate is not None:
                    if gap > LONGEST_GAP:
                        runs = f"the log's clock jumped by {gap:,.0f} s before step {step.step}"
                        print(f"{runs}: waiting {LONGEST_GAP:g} s instead", file=sys.stderr)
                    due += max(0.0, min(gap, LONGEST_GAP)) / rate
                    time.sleep(max(0.0, due - time.monotonic()))
                yield step
                done += 1
                report(done, max(total, done))


class _Logs:
    """The logs of a run by deployment: those given, and those that lie beside the first."""

    def __init__(self, given: dict[int, Path], header: LogHeader) -> None:
        self._given, self._header = given, header
        self._beside = next(iter(given.values())).parent

    def path(self, deployment: int) -> Path:
        """Raises UserError if there is none."""
        path = self._given.get(deployment)
        if path is None:
            path = self._beside / RunFolder(self._beside).deployment(deployment).name
            header = read_header(path) if path.exists() else None
            if header is None or (header.run, header.deployment) != (self._header.run, deployment):
                raise UserError(
                    f"the log of deployment {deployment} is not at hand: give it, too, or put it at"
                    f" {path}"
                )
        return path

    def of_agent(self, agent: str) -> Read:
        """What reads an agent's transitions, by deployment and steps."""

        def read(deployment: int, start: int, stop: int) -> Transitions:
            found = read_transitions(self.path(deployment), agent, start, stop)
            if len(found) != (stop - start) * self._header.copies:
                raise UserError(f"steps {start} to {stop - 1} are not all in the log")
            return found

        return read


def _prepare_learners(
    arguments: argparse.Namespace, parts: list[_Part], description: Description, logs: _Logs
) -> None:
    """See that all is there that learners will ask for, and their run folder as well."""
    if arguments.run is None:
        raise UserError("--learners needs --run DIR, the folder in which fresh learners will work")
    if parts[0][0].path.resolve().parents[1] == arguments.run.resolve():
        raise UserError(
            f"{arguments.run} is the run that these logs are of, whose learners have tuned: fresh"
            " ones need another --run"
        )
    if arguments.steps is not None or arguments.episode is not None:
        raise UserError("learners tune on whole deployments: leave out --steps and --episode")
    team = parts[0][0].header.team
    by_path = {summary.path: summary for summary, _ in parts}
    for deployment in range(1, parts[-1][0].header.deployment + 1):
        path = logs.path(deployment)
        summary = by_path.get(path) or read_summary(path)
        if not summary.extent.whole:
            raise UserError(
                f"{path} does not hold its whole deployment ({summary.extent.shortfall}): learners"
                " would differ"
            )
        if missing := set(team.names) - set(summary.policies):
            raise UserError(f"{path} does not say which policy acted for {min(missing)}")
    folder, header = RunFolder(arguments.run), parts[0][0].header
    try:
        if not folder.description.exists():
            if folder.root.exists() and any(folder.root.iterdir()):
                raise UserError(f"{folder.root} holds something else: learners need another --run")
            user_code.require(*description.code)  # which those learners would run
            folder.root.mkdir(parents=True, exist_ok=True)
            folder.description.write_text(description.to_toml(), encoding="utf-8")
            folder.run_json.write_text(json.dumps({"run": header.run}) + "\n", encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot make {folder.root}: {error.strerror}") from None
    if Description.load(folder.description).digest() != description.digest():
        raise UserError(f"{folder.root} is the folder of another run: its description differs")


@contextmanager
def _centre(root: Path, maximum_payload: int) -> Iterator[Session]:
    """The bus of the run folder `root`, with this process as its centre."""
    endpoint = local_endpoint(root)
    session = Session.listen([Endpoint(endpoint)], maximum_payload)
    try:
        yield session
    finally:
        session.close()
        remove_local_endpoint(endpoint)


def _wait_for_somebody(host: LogHost, root: Path) -> None:
    """Wait until somebody subscribes: what is published before is lost."""
    gone = "" if root.is_dir() else ", a folder that is not there"
    say(
        f"waiting up to {duration(host.deadline)} for somebody to listen on the bus of"
        f" {root}{gone}: to {host.keys.status(HOST)} or others",
        file=sys.stderr,
    )
    start = time.monotonic()
    with shown("waiting for somebody to listen", "s") as report:
        while not host.session.heard:
            waited = min(time.monotonic() - start, host.deadline)
            report(int(waited), int(host.deadline))
            if waited == host.deadline:
                raise UserError(f"nobody listened on the bus of {root} for {host.deadline:g} s")
            time.sleep(_LOOK)
