"""The rules by which transitions are accepted, given their distances: one file each.

`otc_dist/otc/samplers/correction.py` lists them.
"""

from collections.abc import Callable

from otc_dist.description import user_code
from otc_dist.otc.distances.interface import Distance
from otc_dist.otc.samplers.correction import ACCEPTANCES, CorrectionSection
from otc_dist.otc.samplers.interface import Sampler

Accept = Callable[[Distance, CorrectionSection, int], Sampler]  # for batches of that size


def acceptance(name: str) -> Accept:
    """The rule of that name.

    Raises:
        UserError: it is code of the user's own that is not allowed, or cannot be loaded.
    """
    ours = name in ACCEPTANCES
    accept: Accept = user_code.named(ACCEPTANCES[name].place if ours else name, trusted=ours)
    return accept
