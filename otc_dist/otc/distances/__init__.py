"""The distances of OTC, one file each; `otc_dist/description/distances.py` lists them."""

from typing import Any

from otc_dist.description import user_code
from otc_dist.description.distances import DISTANCES
from otc_dist.otc.distances.interface import Distance, Features, Setting
from otc_dist.steps.engine import Engine


def create_distance(name: str, setting: Setting) -> Distance:
    """The distance of that name for one agent.

    Raises:
        UserError: it is code of the user's own that is not allowed, cannot be loaded, or lacks what
            a distance has.
    """
    distance: Distance = _kind(name).create(setting)
    user_code.check_offers(distance, Distance, name)
    return distance


def create_features(name: str, setting: Setting, engine: Engine) -> Features | None:
    """What the distance of that name keeps of transitions; None: it looks at their rows."""
    make = getattr(_kind(name), "features", None)
    features: Features | None = make(setting, engine) if make else None
    return features


def _kind(name: str) -> Any:
    ours = name in DISTANCES
    return user_code.named(DISTANCES[name].place if ours else name, trusted=ours)
