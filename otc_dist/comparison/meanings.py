"""What each arm is, in one line, for people who choose among them."""

from collections.abc import Iterator, Mapping

from otc_dist.comparison.arms import ANALYSES, KNOWN, NULL, ORACLE, PERFECT, REFERENCE
from otc_dist.description.distances import DISTANCES

MEANINGS: Mapping[str, str] = {
    **{
        f"otc-{name}": f"OTC by rank (Eq. 3), {facts.title}: {facts.meaning}"
        for name, facts in DISTANCES.items()
        if name != "random"
    },
    **{
        f"{name}-share": f"the tenth of B_k with the least {facts.title}: {facts.meaning}"
        for name, facts in DISTANCES.items()
    },
    "otc-embedding-fixed": "otc-embedding, with alpha as it is at first",
    "otc-value-fixed": "otc-value, with alpha as it is at first",
    "otc-value-shared": "otc-value, with one normaliser for V(s') and its match's",
    "paper-embedding": "otc-embedding as the paper has it: what imitates sees the same batch",
    "paper-value": "otc-value as the paper has it, its normaliser too",
    "dynamics-conformal": "d_f, accepting what the newest deployment itself could have held",
    "typical-offline": "uniform, from a pi_0 of its own, trained on the typical tenth of B_0",
    REFERENCE: "all of B_k alike: the reference",
    "rlpd": "half of every batch online data, the rest from B_k (RLPD)",
    "online-only": "the deployments' data alone",
    "balanced": "Balanced Replay, by how near to the online data (s, a) is",
    NULL: "uniform with other minibatches: what chance alone does",
    PERFECT: "a ceiling: transitions as they would be with the others acting as now; compare only",
    ORACLE: "a ceiling: the tenth in which the others acted most as now; compare only",
}


def lines(*, analyses: bool) -> Iterator[str]:
    """A line for each arm, with those that no single run can take if `analyses`."""
    names = [*KNOWN, *(ANALYSES if analyses else ())]
    width = max(map(len, names))
    for name in names:
        yield f"  {name:{width}}  {MEANINGS[name]}"
