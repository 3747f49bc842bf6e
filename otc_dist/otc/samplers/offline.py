"""From which rows of B_0 values are learned offline: all, or those that are typical of it."""

import torch

from otc_dist.otc.acceptance import share
from otc_dist.otc.acceptance.weighted import Weighted
from otc_dist.otc.data import Data
from otc_dist.otc.distances.interface import Features, Setting
from otc_dist.otc.distances.typical import TypicalDistance
from otc_dist.otc.samplers.correction import settings_of
from otc_dist.otc.samplers.interface import MergedData, Sampler
from otc_dist.otc.samplers.mixing import ImitatingAll
from otc_dist.otc.samplers.uniform import Uniform


def offline_sampler(setting: Setting) -> Sampler:
    """Uniform, or with `offline.rows = "typical"` the best `offline.share` of B_0 by the residual
    of its forward model, for values alone.
    """
    description, batch = setting.description, setting.description.algorithm.batch_size
    if description.offline.rows == "all":
        return Uniform(batch)
    section = settings_of(description).model_copy(update={"share": description.offline.share})
    best = Weighted(section, batch, TypicalDistance(), share.weights)
    return ImitatingAll(best, batch)


def prepared(sampler: Sampler, held: MergedData, typical: Features) -> Data:
    """B_0 as the typical rows of it are drawn.

    Args:
        typical: what `typical` keeps of transitions, fitted.
    """
    data, size = held.data, held.extent.size
    features = torch.empty(size, typical.size, device=data.rows.device)
    typical.embed(data.rows[:size], data.folds[:size], features)
    alone = held.extent._replace(newest=size)  # nothing of it is online
    return sampler.begin(held._replace(data=data._replace(features=features), extent=alone)).data
