"""What every algorithm's section of a launch description has, and whether it fits an agent.

An algorithm's own section stands in its file in `otc_dist/algorithms`. Hidden sizes and learning
rates are those of Table 3 of the OTC paper; the rest follows the algorithms' own papers and code.
"""

from typing import TYPE_CHECKING, ClassVar

from pydantic import Field, PositiveInt, SerializerFunctionWrapHandler, model_serializer

from otc_dist.description.section import Section
from otc_dist.spec import AgentSpec, Task
from otc_dist.terminal.errors import UserError


class AlgorithmSection(Section):
    """The settings of an algorithm, and what is known of it without training.

    Attributes:
        tuning_updates: L, updates after each deployment (Table 3).
        has_q: whether d_q can be used.
        discrete: whether it is for discrete actions, otherwise for continuous ones.
        plans: whether it needs to know the task.
        update: milliseconds of one core for an update, compiled, at Table 3's sizes
            (benchmarks/algorithms.py).
        brief: assignments with which the same code runs in less time: where it is only compiled,
            and in a quick look.
    """

    tuning_updates: ClassVar[int] = 4000
    has_q: ClassVar[bool] = True
    discrete: ClassVar[bool] = False
    plans: ClassVar[bool] = False
    update: ClassVar[float] = 1.0
    brief: ClassVar[tuple[str, ...]] = ()

    if TYPE_CHECKING:
        name: str  # each section has its own, after the fields that all have

    batch_size: int = Field(default=128, ge=1, description="transitions of an update")
    discount: float = Field(default=0.99, ge=0, lt=1, description="gamma, of a step")

    def afterwards(self, engine: str) -> float:
        """Milliseconds of one core that a phase takes after its updates."""
        return 0.0

    @model_serializer(mode="wrap")
    def _serialise(self, handler: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Without what is None, for which TOML has no word: read back, it digests to the same."""
        return {key: value for key, value in handler(self).items() if value is not None}


class SmallSection(AlgorithmSection):
    """Table 3's networks of 64 and 64."""

    hidden: tuple[PositiveInt, ...] = Field(
        default=(64, 64), description="hidden layers of every network"
    )
    target_rate: float = Field(default=0.005, gt=0, le=1, description="tau of the target networks")


class LargeSection(AlgorithmSection):
    """Table 3's networks of 256 and 256."""

    tuning_updates: ClassVar[int] = 2000

    hidden: tuple[PositiveInt, ...] = Field(
        default=(256, 256), description="hidden layers of every network"
    )


def check_fit(section: AlgorithmSection, spec: AgentSpec, task: Task | None) -> None:
    """Refuse an algorithm for the other kind of actions, or one that plans and knows no task.

    Raises:
        UserError: it does not fit; the message says what does.
    """
    name = f"algorithm.name = {section.name!r}"
    if section.discrete != bool(spec.choices):
        has = f"{spec.choices} discrete actions" if spec.choices else "continuous actions"
        suited = "'discrete-cql'" if spec.choices else "for example 'td3bc'"
        raise UserError(f"{name} does not fit {spec.name}, which has {has}; use {suited}")
    if section.plans and task is None:
        raise UserError(
            f"{name} plans in a model and needs the task's reward function, which this"
            " environment does not provide; use another algorithm"
        )
