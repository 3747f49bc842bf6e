"""Online transition correction: distances, matching, prioritization, adaptive alpha, samplers."""

from otc_dist.algorithms.interface import Algorithm, Critic
from otc_dist.description import SamplingSection
from otc_dist.otc.balanced import Balanced
from otc_dist.otc.samplers import Otc, Sampler, Uniform
from otc_dist.transitions import RowLayout


def create_sampler(
    section: SamplingSection,
    algorithm: Algorithm,
    layout: RowLayout,
    batch_size: int,
    capacity: int,
) -> Sampler:
    """The described sampling strategy, over a replay buffer of `capacity` rows."""
    if section.name == "otc":
        critic = algorithm if isinstance(algorithm, Critic) else None
        return Otc(critic, layout, section, batch_size)
    if section.name == "balanced":
        return Balanced(
            layout,
            batch_size,
            capacity,
            section.density_hidden,
            section.density_learning_rate,
            section.temperature,
        )
    return Uniform(batch_size, online_only=section.name == "online-only")
