"""Base algorithms, one file each, behind one interface."""

from otc_dist.algorithms.bcq import Bcq
from otc_dist.algorithms.interface import Algorithm
from otc_dist.description import AlgorithmSection


def create(section: AlgorithmSection, observation_size: int, action_size: int) -> Algorithm:
    """The described algorithm for one agent's sizes."""
    settings = section.model_dump(exclude={"name", "batch_size"})
    return Bcq(observation_size, action_size, **settings)
