"""Sources of offline data by environment. Another family's is one more line in `_SOURCES`."""

from otc_dist.datasets.random_source import RandomSource
from otc_dist.datasets.robot_source import RobotSource
from otc_dist.datasets.skirmish_source import SkirmishSource
from otc_dist.datasets.source import Source

_SOURCES: tuple[Source, ...] = (RobotSource(), RandomSource(), SkirmishSource())


def source_of(env_id: str) -> Source | None:
    """Who can make data of that environment; None where data can only be imported."""
    return next((source for source in _SOURCES if source.offers(env_id)), None)
