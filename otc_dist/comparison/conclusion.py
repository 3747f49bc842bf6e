"""What a comparison shows, in a few sentences that claim nothing which chance also does."""

from collections.abc import Mapping

from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.comparison.intervals import Difference
from otc_dist.comparison.judgement import MEAN, RECOMMENDED

ENOUGH = 10  # seeds for any claim
_WHERE = {RECOMMENDED: "By the recommended policy", MEAN: "Over the deployments"}

Differences = Mapping[str, Difference]  # arm -> what it has over the reference


def conclude(found: Mapping[str, Differences]) -> str:
    """Sentences on the recommended policy and on the mean over deployments.

    An arm is said to differ if both intervals of its difference leave out zero and its mean lies
    outside both of the null arm's; and only with ENOUGH seeds of the arm and of the null arm.

    Args:
        found: of each measure of `judgement.JUDGED`, the differences of all arms that have one.
    """
    return " ".join(_sentence(_WHERE[measure], found.get(measure, {})) for measure in _WHERE)


def _sentence(where: str, found: Differences) -> str:
    if NULL not in found:
        return f"{where}: no claim without the null arm."
    null = found[NULL]
    chance = f"by chance alone, the null arm differs by {null}"
    most = max((len(one.seeds) for one in found.values()), default=0)
    if most < ENOUGH or len(null.seeds) < ENOUGH:
        count = "1 seed is" if len(null.seeds) == 1 else f"{len(null.seeds)} seeds are"
        return f"{where}: {count} too few for any claim (ten are needed): {chance}."
    claims = []
    for name, one in found.items():
        beyond = one.mean > max(null.high, null.t_high, 0)
        beyond |= one.mean < min(null.low, null.t_low, 0)
        if name != NULL and beyond and one.excludes_zero and len(one.seeds) >= ENOUGH:
            better = "better" if one.mean > 0 else "worse"
            claims.append(f"{name} was {better} than {REFERENCE} by {one}")
    if not claims:
        return f"{where}: no arm differs from {REFERENCE} by more than chance does; {chance}."
    return f"{where}: {', '.join(claims)}; {chance}; other arms: no claim."
