"""What a sampler is given before the updates, for the tests that begin one by hand."""

from typing import Any

import numpy as np

from otc_dist.otc.data import Data
from otc_dist.otc.samplers.interface import Extent, MergedData
from otc_dist.steps.engine import Engine
from otc_dist.steps.state import State


def held_by(state: State, data: Data, extent: Extent, random: np.random.Generator) -> MergedData:
    """All random streams are `random`."""

    def stream(*key: Any) -> np.random.Generator:
        return random

    return MergedData(state, data, extent, Engine("eager"), stream)
