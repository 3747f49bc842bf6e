"""What an agent's distances fit to B_0, once, before its first deployment."""

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from otc_dist.learner import checkpoint
from otc_dist.learner.experience import Experience
from otc_dist.otc.distances import create_features
from otc_dist.otc.distances.interface import Features, Setting
from otc_dist.steps.engine import Engine
from otc_dist.steps.noise import to_tensors
from otc_dist.steps.state import State

Report = Callable[[str, int, int, dict[str, float]], None]  # of which, updates done, of how many


class Fits:
    """The fits that a description needs, and further ones that its checkpoints are to hold.

    Args:
        further: distances that other descriptions use, which start from the same policy.

    Attributes:
        own: what the description's own distance keeps of every transition; None: nothing.
    """

    def __init__(self, setting: Setting, engine: Engine, further: Iterable[str] = ()) -> None:
        self._engine = engine
        compared = setting.description.sampling.compared
        first = ("typical",) if setting.description.offline.rows == "typical" else ()
        self._fits: dict[str, Features] = {}  # by distance
        for distance in (*first, *([compared] if compared else []), *further):
            if features := create_features(distance, setting, engine):
                self._fits.setdefault(distance, features)
        self.own = self._fits.get(compared) if compared else None

    def __bool__(self) -> bool:
        """Whether there is anything to fit."""
        return bool(self._fits)

    def of(self, distance: str) -> Features:
        """What that distance fits."""
        return self._fits[distance]

    def train(
        self,
        experience: Experience,
        stream: Callable[..., np.random.Generator],
        report: Report,
        *distances: str,
    ) -> None:
        """Fit what these distances lack; without names, what all lack."""
        for distance in distances or self._fits:
            features = self._fits[distance]
            if features.state is None:
                self._train(features, experience, stream, report)

    def _train(
        self,
        features: Features,
        experience: Experience,
        stream: Callable[..., np.random.Generator],
        report: Report,
    ) -> None:
        name, rows = features.name, experience.offline
        features.fit(
            rows,
            experience.folds[: len(rows)],
            lambda *key: stream(name, *key),
            lambda done, metrics: report(name, done, features.updates, metrics),
        )
        for other in self._fits.values():
            if other.name == name:  # d_f and `typical` share theirs
                other.state = features.state
        if self.own and self.own.name == name:
            experience.embed()

    def states(self) -> dict[str, State]:
        """Name -> what was fitted, as a checkpoint keeps it."""
        return {f.name: f.state for f in self._fits.values() if f.state is not None}

    def load(
        self,
        parts: Mapping[str, checkpoint.Arrays],
        experience: Experience,
        stream: Callable[..., np.random.Generator],
    ) -> bool:
        """Take over the parts of a checkpoint; whether none is missing that must be trained."""
        complete = True
        for features in self._fits.values():
            if features.name in parts:
                features.state = to_tensors(parts[features.name], self._engine.device)
            elif features.updates:
                complete = False
            else:  # it takes no time
                self._train(features, experience, stream, _untold)
        experience.embed()
        return complete


def _untold(name: str, done: int, of: int, metrics: dict[str, float]) -> None:
    pass
