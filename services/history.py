"""What the env host answers to a learner that asks for its own past: pages read from the log."""

from otc_dist.bus.history import history_reply
from otc_dist.bus.session import Query
from otc_dist.bus.wire import Rejections
from otc_dist.deployment_log.reader import read_transitions
from otc_dist.transitions import Transitions

from .process import Run


def history_of(run: Run, agent: str, rejections: Rejections) -> Query:
    """Answers queries for the transitions of `agent`; see `history_reply`."""

    def read(k: int, start: int, stop: int) -> Transitions:
        return read_transitions(run.folder.deployment(k), agent, start, stop)

    spec, description = run.team.agents[run.team.index(agent)], run.description
    return history_reply(run.keys, spec, description, run.maximum_payload, read, rejections)
