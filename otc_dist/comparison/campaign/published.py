"""What a publication says of a campaign's comparisons, as its file quotes it."""

from collections.abc import Sequence
from typing import Annotated, Self

from pydantic import Field

from otc_dist.description.section import Section

Spread = tuple[float, float]  # mean, standard deviation


class Published(Section):
    """Change from pi_0 at the last deployment, in percent: mean and standard deviation.

    Attributes:
        source: where the numbers stand.
        parts: part -> data set -> arm -> what is printed; what is not there, is not printed.
    """

    source: str
    parts: dict[str, dict[str, dict[str, Spread]]]

    @classmethod
    def together(cls, several: Sequence[Self]) -> Self | None:
        """Of parts with different names; None of none."""
        if not several:
            return None
        sources = dict.fromkeys(one.source for one in several)
        parts = {part: numbers for one in several for part, numbers in one.parts.items()}
        return cls(source="; ".join(sources), parts=parts)

    @property
    def datasets(self) -> list[str]:
        """In the order in which they are printed."""
        return list(dict.fromkeys(dataset for part in self.parts.values() for dataset in part))

    def arms(self, part: str) -> set[str]:
        """Those of which something is printed."""
        return {arm for arms in self.parts.get(part, {}).values() for arm in arms}

    def of(self, part: str, dataset: str) -> dict[str, Spread]:
        """Arm -> what is printed of it there."""
        return self.parts.get(part, {}).get(dataset, {})


class Figure(Section):
    """A claim of the publication: that some arms are better than others.

    Attributes:
        title: which figure or table makes it.
        claim: in its words, or shortened.
        parts: of the campaign, whose comparisons show it; others may be those of another campaign.
        datasets: of these parts; none: all that they have.
        better: arms of which it is claimed.
        than: arms that they are to be better than.
        beside: arms that are drawn with them, and not judged.
        alpha: whether the figure shows alpha as well.
    """

    title: str
    claim: str
    parts: Annotated[tuple[str, ...], Field(min_length=1)]
    datasets: tuple[str, ...] = ()
    better: Annotated[tuple[str, ...], Field(min_length=1)]
    than: Annotated[tuple[str, ...], Field(min_length=1)]
    beside: tuple[str, ...] = ()
    alpha: bool = False

    @property
    def arms(self) -> tuple[str, ...]:
        return (*self.better, *self.than)
