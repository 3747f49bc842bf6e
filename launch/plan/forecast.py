"""How long a run will take: what is to be done, at rates measured once on two cores.

A forecast, not a promise: machines differ by more than a factor of two. The live view corrects
it by how long the finished parts really took.
"""

import math
import os
from dataclasses import dataclass, replace

from otc_dist.description import Description
from otc_dist.description.distances import DISTANCES, facts_of
from otc_dist.envs import registry
from otc_dist.run.exploration import Schedule
from otc_dist.spec import TeamSpec

ENGINES = {"compiled": 1.0, "eager": 4.0, "cuda-graph": 0.3}  # times as long
ACT = 2.0  # one agent's answer for all copies, and the message both ways
START_SECONDS = 6.0  # of all processes, up to their first sign of life


@dataclass(frozen=True)
class Part:
    """One part of a run: which phase, of which deployment, and its expected seconds."""

    phase: str
    deployment: int
    seconds: float


def offline(description: Description, seeds: int = 1) -> float:
    """Seconds of one core for one agent's pi_0, without the embedding.

    Args:
        seeds: whose updates are made at once, as if they took no longer than one's: a guess. What
            is there for 0 is the updates alone.
    """
    return _trained(description, description.offline.updates, selection=0.0, seeds=seeds)


def fit(description: Description) -> Part:
    """Seconds of one core for what one agent's distance fits to B_0; 0 where it fits nothing."""
    compared = description.sampling.compared
    facts = facts_of(compared) if compared else None
    if facts is None or facts.fits is None:
        return Part("offline", 0, 0.0)
    updates = {
        "embedding": description.embedding.updates,
        "dynamics": 2 * description.dynamics.updates,  # of its two networks
    }[facts.fits]
    each = facts.fit_update * ENGINES[description.engine.name]
    return Part(facts.fits, 0, updates * each / 1000)


def fits(description: Description) -> float:
    """Seconds of one core for what all distances fit to B_0, which comparisons do at once."""
    every = {facts.fits: name for name, facts in DISTANCES.items() if facts.fits}
    return sum(
        fit(description.with_assignments("sampling.name=otc", f"sampling.distance={name}")).seconds
        for name in every.values()
    )


def tuning(description: Description) -> float:
    """Seconds of one core for one agent's tuning after one deployment."""
    cost, size = description.sampling.cost, description.dataset.transitions
    trained = _trained(description, description.deployment.updates, cost.update)
    return trained + cost.scoring * size / 1e6


def acting(description: Description, team: TeamSpec) -> float:
    """Seconds of one core for one agent's answers in one deployment."""
    return Schedule.of(description, len(team.agents)).steps * ACT / 1000


def deploying(description: Description, team: TeamSpec, sharing: float) -> float:
    """Seconds of one deployment; of devices that do not wait at least those of their clock."""
    seconds, rate = sharing * acting(description, team), description.deployment.rate_hz
    steps = Schedule.of(description, len(team.agents)).steps
    return max(seconds, steps / rate) if rate else seconds


def judging(description: Description, team: TeamSpec) -> float:
    """At most these seconds of one core for one agent's answers in one evaluation."""
    episodes = description.evaluation.episodes
    rounds = math.ceil(episodes / max(registry.affordable(team.env_id, episodes), 1))
    return rounds * team.max_episode_steps * ACT / 1000


def _trained(description: Description, updates: int, selection: float, seeds: int = 1) -> float:
    algorithm, engine = description.algorithm, description.engine.name
    each = (algorithm.update + selection) * ENGINES[engine]
    return (updates * each + seeds * algorithm.afterwards(engine)) / 1000


def parts(description: Description, team: TeamSpec, here: int) -> list[Part]:
    """All parts of a run, in order.

    Args:
        here: how many agents learn on this machine, and share its cores while they train and act.
            Those of other machines are taken for as fast as one alone here.
    """
    agents = max(here, 1)
    cores = min(os.cpu_count() or 1, agents)
    sharing = agents / (cores if description.engine.name != "cuda-graph" else 1)
    evaluation = sharing * judging(description, team)
    run = [
        Part("start", 0, START_SECONDS),
        Part("offline", 0, sharing * offline(description)),
        replace(fitted := fit(description), seconds=sharing * fitted.seconds),
        Part("evaluation", 0, evaluation),
    ]
    for k in range(1, description.deployment.count + 1):
        run += [
            Part("deployment", k, deploying(description, team, sharing)),
            Part("tuning", k, sharing * tuning(description)),
            Part("evaluation", k, evaluation),
        ]
    if description.deployment.confirm:
        last = description.deployment.total
        run.append(Part("deployment", last, deploying(description, team, sharing)))
    return run


class Remaining:
    """Seconds still to go, from the forecast and from how true it has been so far."""

    def __init__(self, run: list[Part]) -> None:
        self._run = run
        self._first: tuple[float, float] | None = None  # (clock, forecast seconds done) then

    def seconds(self, phase: str, deployment: int, share: float, clock: float) -> float | None:
        """To go when `share` of (phase, deployment) is done at `clock` seconds; None if that is no
        part of the work, but a wait of which nobody knows how long it takes.
        """
        if (phase, deployment) not in {(part.phase, part.deployment) for part in self._run}:
            return None
        total = sum(part.seconds for part in self._run)
        done = 0.0
        for part in self._run:
            if (part.phase, part.deployment) == (phase, deployment):
                done += part.seconds * share
                break
            done += part.seconds
        if self._first is None or done < self._first[1]:  # begun, or begun again further back
            self._first = (clock, done)
        start, before = self._first
        # Trust the table until some seconds have shown how this machine compares with it.
        slower = (clock - start + 5.0) / (done - before + 5.0)
        return (total - done) * slower
