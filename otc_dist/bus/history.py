"""An agent's own past, asked of the env host's log page by page."""

import time

from otc_dist.bus.keys import Keys
from otc_dist.bus.lockstep import GaveUpError
from otc_dist.bus.replies import decode_history
from otc_dist.bus.session import Session
from otc_dist.bus.wire import RejectedError, Rejections
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

_RETRY = 0.2  # seconds
_PATIENCE = 5.0  # seconds for one page


class History:
    """Fetches transitions of one agent.

    Args:
        copies: E, transitions a step.
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
