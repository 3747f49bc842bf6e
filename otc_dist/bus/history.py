"""An agent's own past, asked of the env host's log page by page, and the answer."""

import time
from collections.abc import Callable, Mapping

from otc_dist.bus.keys import Keys
from otc_dist.bus.lockstep import GaveUpError
from otc_dist.bus.replies import decode_history, encode_history, history_rows
from otc_dist.bus.session import Query, Session
from otc_dist.bus.wire import RejectedError, Rejections
from otc_dist.description import Description
from otc_dist.spec import AgentSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Transitions

Read = Callable[[int, int, int], Transitions]  # deployment, start, stop (steps)

_RETRY = 0.2  # seconds
_PATIENCE = 5.0  # seconds for one page
_LONGEST_NUMBER = 10  # digits


class History:
    """Fetches transitions of one agent.

    Args:
        copies: E, transitions per step.
        deadline: seconds without a new page after which `fetch` gives up.
    """

    def __init__(
        self,
        session: Session,
        keys: Keys,
        agent: AgentSpec,
        copies: int,
        deadline: float,
        rejections: Rejections,
    ) -> None:
        self._session, self._keys, self._agent = session, keys, agent
        self._copies, self._deadline, self._rejections = copies, deadline, rejections

    def fetch(self, deployment: int, start: int, stop: int) -> Transitions:
        """The transitions of steps start..stop-1 (at least one) of a deployment.

        Raises:
            GaveUpError: the env host did not give them.
        """
        pages: list[Transitions] = []
        heard, reason = time.monotonic(), "no answer"
        while start < stop:
            try:
                page = self._page(deployment, start, stop)
            except LookupError as error:
                page, reason = None, str(error.args[0])
            except RejectedError as rejected:
                self._rejections.count(rejected)
                page, reason = None, f"rejected: {rejected}"
            if page is not None and len(page):
                pages.append(page)
                start += len(page) // self._copies
                heard = time.monotonic()
            elif time.monotonic() - heard > self._deadline:
                raise GaveUpError(
                    f"the env host did not give the history of deployment {deployment}, steps"
                    f" {start} to {stop - 1}, for {self._deadline:g} s ({reason})"
                )
            else:
                time.sleep(_RETRY)
        return Transitions.concatenate(pages)

    def _page(self, deployment: int, start: int, stop: int) -> Transitions | None:
        parameters = {"deployment": str(deployment), "start": str(start), "stop": str(stop)}
        key = self._keys.history(self._agent.name)
        payload = self._session.ask(key, parameters, _PATIENCE)
        if payload is None:
            return None
        page = decode_history(payload, self._keys.run, self._agent, deployment, start)
        if len(page) % self._copies or len(page) > (stop - start) * self._copies:
            raise RejectedError("shape")
        return page


def history_reply(
    keys: Keys,
    agent: AgentSpec,
    description: Description,
    maximum_payload: int,
    read: Read,
    rejections: Rejections,
) -> Query:
    """Answers queries for the transitions of `agent`, which `read` gets from a log.

    The answer raises LookupError, whose text is sent, for a query that makes no sense (it is
    counted as `query`) and for steps that are not in the log.
    """
    rows = history_rows(agent, maximum_payload)
    page = max(1, rows // description.env.copies)  # steps
    deployments = description.deployment.total

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
            found = read(k, start, min(stop, start + page))
        except (UserError, ValueError) as error:
            raise LookupError(str(error)) from None
        return encode_history(keys.run, agent.name, k, start, found)

    return reply


def _number(text: str | None) -> int:
    if text is None or not (text.isascii() and text.isdigit() and len(text) <= _LONGEST_NUMBER):
        raise RejectedError("query")
    return int(text)
