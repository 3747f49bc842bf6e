"""What every sampling strategy's section of a launch description has.

A strategy's own section stands in its file in `otc_dist/otc`.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from pydantic import PrivateAttr, SerializerFunctionWrapHandler, model_serializer

from otc_dist.description.algorithms import AlgorithmSection
from otc_dist.description.section import Section

# Digests of descriptions are of these settings, in this order, whichever strategy is chosen. Those
# of a strategy that came later are part of them where it is chosen, or where they were given.
ALWAYS = (
    *("name", "distance", "acceptance", "corrects", "share", "level", "online_share", "matching"),
    *("candidates", "references", "alpha", "adaptive", "alpha_bound", "with_replacement"),
    *("exclude_self", "normaliser", "value_samples", "similarity_sample"),
    *("density_hidden", "density_learning_rate", "temperature"),
)


class Arm(NamedTuple):
    """What a comparison calls by a name: assignments to a description, and one line for people."""

    assignments: tuple[str, ...]
    meaning: str


class Cost(NamedTuple):
    """What a strategy adds to training, of one core, compiled."""

    update: float = 0.0  # milliseconds, of each update while tuning
    scoring: float = 0.0  # milliseconds for a thousand transitions, once a deployment


class SamplingSection(Section):
    """The settings of a sampling strategy, and what is known of it without training.

    The settings of other strategies may stand beside them: a comparison's description holds those
    of all its arms.

    Attributes:
        arms: in which comparisons know it.
        row: how the check of the mechanism calls it; empty: it is not held against others there.
        bound: whether it is made for as many transitions as it began with.
    """

    arms: ClassVar[Mapping[str, Arm]] = {}
    row: ClassVar[str] = ""
    bound: ClassVar[bool] = False

    if TYPE_CHECKING:
        name: str  # each section has its own

    _beside: dict[str, object] = PrivateAttr(default_factory=dict)

    @property
    def code(self) -> tuple[str, ...]:
        """What of it may name code of the user's own."""
        return (self.name,)

    @property
    def compared(self) -> str | None:
        """The distance that it uses; None: none."""
        return None

    @property
    def title(self) -> str:
        """How a heading calls it."""
        return f"{self.name} sampling"

    @property
    def cost(self) -> Cost:
        """Milliseconds that it takes, beside what its distance fits to B_0."""
        return Cost()

    def check(self, algorithm: AlgorithmSection, deployed: int) -> None:
        """Raises ValueError where it cannot go together with what else a description says.

        Args:
            deployed: M, 0 where it is not known yet.
        """

    def with_others(self, settings: dict[str, object]) -> "SamplingSection":
        """The same with the settings of other strategies beside it."""
        made = self.model_copy()
        made._beside = settings
        return made

    @model_serializer(mode="wrap")
    def _serialise(self, handler: SerializerFunctionWrapHandler) -> dict[str, object]:
        own: dict[str, object] = handler(self)
        settings = {**self._beside, **own}
        order = dict.fromkeys((*ALWAYS, *own, *self._beside))
        return {key: settings[key] for key in order if settings.get(key) is not None}
