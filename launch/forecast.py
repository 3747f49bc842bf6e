"""How long a run will take: what is to be done, at rates measured once on two cores.

A forecast, not a promise: machines differ by more than a factor of two. The live view corrects
it by how long the finished parts really took.
"""

import os
from dataclasses import dataclass

from otc_dist.description import Description
from otc_dist.exploration import Schedule

# Milliseconds of one core. Updates: BCQ at Table 3's sizes, one agent.
UPDATE = {"compiled": 2.0, "cuda-graph": 0.4, "eager": 8.0}
OTC_UPDATE = {"compiled": 1.2, "cuda-graph": 0.1, "eager": 8.0}  # on top, while tuning
EMBEDDING_UPDATE = {"compiled": 0.8, "cuda-graph": 0.2, "eager": 2.2}
ACT = 2.0  # one agent's answer for all copies: its candidates, and the message both ways
START_SECONDS = 6.0  # of all processes, up to their first sign of life
EPISODE_STEPS = 1000  # upper bound on an evaluation's lock-steps


@dataclass(frozen=True)
class Part:
    """One part of a run: which phase, of which deployment, and its expected seconds."""

    phase: str
    deployment: int
    seconds: float


def parts(description: Description, agents: int) -> list[Part]:
    """All parts of a run, in order. Agents share the cores while they train and act."""
    cores = min(os.cpu_count() or 1, agents)
    sharing = agents / (cores if description.engine.name != "cuda-graph" else 1)
    engine = description.engine.name
    update = UPDATE.get(engine, UPDATE["eager"])
    tuning = update + (
        OTC_UPDATE.get(engine, OTC_UPDATE["eager"]) if description.sampling.name == "otc" else 0.0
    )
    embedding = EMBEDDING_UPDATE.get(engine, EMBEDDING_UPDATE["eager"])
    scale = sharing / 1000
    step = ACT * scale
    steps = Schedule.of(description, agents).steps
    evaluation = EPISODE_STEPS * step if description.evaluation.episodes else 0.0
    run = [
        Part("start", 0, START_SECONDS),
        Part("offline", 0, description.offline.updates * update * scale),
        Part("embedding", 0, description.embedding.updates * embedding * scale),
        Part("evaluation", 0, evaluation),
    ]
    for k in range(1, description.deployment.count + 1):
        run += [
            Part("deployment", k, steps * step),
            Part("tuning", k, description.deployment.updates * tuning * scale),
            Part("evaluation", k, evaluation),
        ]
    return run


class Remaining:
    """Seconds still to go, from the forecast and from how true it has been so far."""

    def __init__(self, run: list[Part]) -> None:
        self._run = run
        self._first: tuple[float, float] | None = None  # (clock, forecast seconds done) then

    def seconds(self, phase: str, deployment: int, share: float, clock: float) -> float:
        """To go when `share` of (phase, deployment) is done at `clock` seconds."""
        total = sum(part.seconds for part in self._run)
        done = 0.0
        for part in self._run:
            if (part.phase, part.deployment) == (phase, deployment):
                done += part.seconds * share
                break
            done += part.seconds
        if self._first is None:
            self._first = (clock, done)
        start, before = self._first
        # Trust the table until some seconds have shown how this machine compares with it.
        slower = (clock - start + 5.0) / (done - before + 5.0)
        return (total - done) * slower


def duration(seconds: float) -> str:
    """3725 -> '1:02:05', 65 -> '1:05'."""
    whole = round(seconds)
    minutes = f"{whole % 3600 // 60}:{whole % 60:02d}"
    return f"{whole // 3600}:{minutes.zfill(5)}" if whole >= 3600 else minutes
