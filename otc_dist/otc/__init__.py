"""Online transition correction, and the strategies that it is compared with.

A sampler (samplers/) chooses the rows of an update. OTC's is made of a distance (distances/), which
says how unlike the newest deployment's a transition is, and a rule of acceptance (acceptance/).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from otc_dist.description.kinds import STRATEGIES

if TYPE_CHECKING:
    from otc_dist.otc.distances.interface import Setting
    from otc_dist.otc.samplers.interface import Sampler


def create_sampler(setting: Setting, capacity: int) -> Sampler:
    """The described sampling strategy, over a replay buffer of `capacity` rows.

    Raises:
        UserError: it is code of the user's own that is not allowed, or cannot be loaded.
    """
    section = setting.description.sampling
    sampler: Sampler = STRATEGIES.find(section.name).create(section, setting, capacity)
    return sampler
