"""D_k as one learner gathers it: its own observations and actions, and what came of them."""

from collections.abc import Callable

from otc_dist.bus.messages import Moment, Observation
from otc_dist.transitions import Float32, Transitions

Fetch = Callable[[int, int, int], Transitions]  # (deployment, start, stop) -> those steps


class Gathering:
    """The transitions of the deployment under way, step by step.

    Args:
        copies: E, transitions per step.
        own: the deployment's steps that belong to this agent's D_k.
        fetch: where steps come from that this process did not see (it was restarted).
    """

    def __init__(self, copies: int, own: range, fetch: Fetch) -> None:
        self._copies, self._own, self._fetch = copies, own, fetch
        self._deployment = 0
        self._steps: list[Transitions] = []  # E transitions each
        self._acted: tuple[Moment, Float32, Float32] | None = None

    def acted(self, moment: Moment, observations: Float32, actions: Float32) -> None:
        """Note what was answered; its outcome comes with a later question."""
        self._acted = (moment, observations, actions)

    def take(self, question: Observation) -> None:
        """Complete D_k up to the step before the question's."""
        moment = question.moment
        self._begin(moment.deployment)
        wanted = min(max(moment.step, self._own.start), self._own.stop) - self._own.start
        del self._steps[wanted:]
        missing = wanted - len(self._steps)
        if missing == 1 and question.outcome is not None and self._acted is not None:
            before, observations, actions = self._acted
            newest = self._own.start + wanted - 1
            if (before.deployment, before.step) == (moment.deployment, newest) and (
                moment.step == newest + 1
            ):
                outcome = question.outcome
                self._steps.append(
                    Transitions(
                        observations,
                        actions,
                        outcome.rewards,
                        outcome.next_observations,
                        outcome.terminated,
                        outcome.truncated,
                    )
                )
                return
        self._complete(wanted)

    def all(self, deployment: int) -> Transitions:
        """D_k whole."""
        self._begin(deployment)
        self._complete(len(self._own))
        return Transitions.concatenate(self._steps)

    def _begin(self, deployment: int) -> None:
        if deployment != self._deployment:
            self._deployment, self._steps = deployment, []

    def _complete(self, steps: int) -> None:
        have, copies = len(self._steps), self._copies
        if have < steps:
            start = self._own.start
            fetched = self._fetch(self._deployment, start + have, start + steps)
            self._steps += [
                fetched[first : first + copies] for first in range(0, len(fetched), copies)
            ]
