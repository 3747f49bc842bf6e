"""Online transition correction: distances, acceptance, samplers."""

from otc_dist.description import SamplingSection
from otc_dist.otc.acceptance import ACCEPTANCES
from otc_dist.otc.balanced import Balanced
from otc_dist.otc.distances import create_distance
from otc_dist.otc.distances.interface import Setting
from otc_dist.otc.mixing import ImitatingAll, WithOnline
from otc_dist.otc.samplers import Sampler, Uniform


def create_sampler(setting: Setting, capacity: int) -> Sampler:
    """The described sampling strategy, over a replay buffer of `capacity` rows."""
    sampling, batch = setting.description.sampling, setting.description.algorithm.batch_size
    online = round(sampling.online_share * batch)
    sampler = _chosen(setting, batch - online, capacity)
    if online:
        sampler = WithOnline(sampler, online)
    if sampling.name == "otc" and sampling.corrects == "values":
        sampler = ImitatingAll(sampler, batch)
    return sampler


def _chosen(setting: Setting, count: int, capacity: int) -> Sampler:
    """What chooses `count` transitions, without the online data beside them."""
    section: SamplingSection = setting.description.sampling
    if section.name == "otc":
        distance = create_distance(section.distance, setting)
        return ACCEPTANCES[section.acceptance](distance, section, count)
    if section.name == "balanced":
        return Balanced(
            setting.layout,
            count,
            capacity,
            section.density_hidden,
            section.density_learning_rate,
            section.temperature,
        )
    return Uniform(count, online_only=section.name == "online-only")
