"""`random`: no distance at all. The best tenth by it is a random tenth: the control."""

from dataclasses import dataclass

import numpy as np
import torch

from otc_dist.otc.distances.interface import Scores, Setting
from otc_dist.otc.samplers.interface import MergedData


@dataclass(frozen=True)
class RandomDistance:
    """A uniform random number for every transition, anew at each deployment."""

    @classmethod
    def create(cls, setting: Setting) -> "RandomDistance":
        return cls()

    def scores(self, held: MergedData, *, exclude_self: bool) -> Scores:
        drawn = held.random("scores").random(held.extent.size, np.float32)
        return Scores(torch.from_numpy(drawn).to(held.data.rows.device))
