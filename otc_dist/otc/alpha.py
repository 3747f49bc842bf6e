"""Adaptive alpha (Eq. 4)."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Alpha:
    """Degree of the correction and the expected similarity it was last adapted to.

    alpha_k = alpha_{k-1} D_k / D_{k-1}, which telescopes to alpha_0 D_k / D_1.
    """

    value: float
    similarity: float = math.nan  # 𝔻_{k-1}; not a number before the first deployment

    def adapt(self, similarity: float, bound: float = 0.0) -> "Alpha":
        """alpha_k from 𝔻_k. At the first deployment alpha is alpha_0.

        alpha is held where either 𝔻 is not positive and finite. A `bound` above 0 caps alpha.
        """
        if not _usable(similarity):
            return self
        if not _usable(self.similarity):
            return Alpha(self.value, similarity)
        value = self.value * similarity / self.similarity
        return Alpha(min(value, bound) if bound else value, similarity)


def _usable(similarity: float) -> bool:
    return math.isfinite(similarity) and similarity > 0
