"""The rules by which transitions are accepted, given their distances: one file each."""

from collections.abc import Callable

from otc_dist.otc.acceptance import conformal, rank, share
from otc_dist.otc.correction import CorrectionSection
from otc_dist.otc.distances.interface import Distance
from otc_dist.otc.samplers import Sampler

ACCEPTANCES: dict[str, Callable[[Distance, CorrectionSection, int], Sampler]] = {
    "rank": rank.create,
    "share": share.create,
    "conformal": conformal.create,
}
