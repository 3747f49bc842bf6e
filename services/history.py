"""What the env host answers to a learner that asks for its own past: pages read from the log."""

from collections.abc import Mapping

from otc_dist.bus.replies import encode_history, history_rows
from otc_dist.bus.session import Query
from otc_dist.bus.wire import RejectedError, Rejections
from otc_dist.deployment_log.reader import read_transitions
from otc_dist.errors import UserError

from .process import Run

_LONGEST_NUMBER = 10  # digits


def history_of(run: Run, agent: str, rejections: Rejections) -> Query:
    """Answers queries for the transitions of `agent`.

    The answer raises LookupError, whose text is sent, for a query that makes no sense (it is
    counted as `query`) and for steps that are not in the log.
    """
    spec = run.team.agents[run.team.index(agent)]
    rows = history_rows(spec, run.maximum_payload)
    page = max(1, rows // run.description.env.copies)  # steps
    deployments = run.description.deployment.count

    def reply(parameters: Mapping[str, str]) -> bytes:
        try:
            names = ("deployment", "start", "stop")
            k, start, stop = (_number(parameters.get(name)) for name in names)
            if not (1 <= k <= deployments and start < stop):
                raise RejectedError("query")
        except RejectedError as rejected:
            rejections.count(rejected)
            raise LookupError(
                f"a history query needs deployment 1 .. {deployments} and start < stop"
            ) from None
        try:
            path = run.folder.deployment(k)
            found = read_transitions(path, agent, start, min(stop, start + page))
        except (UserError, ValueError) as error:
            raise LookupError(str(error)) from None
        return encode_history(run.keys.run, agent, k, start, found)

    return reply


def _number(text: str | None) -> int:
    if text is None or not (text.isascii() and text.isdigit() and len(text) <= _LONGEST_NUMBER):
        raise RejectedError("query")
    return int(text)
