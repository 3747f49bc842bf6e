"""The algorithm's section of a launch description: one class for each base algorithm.

Hidden sizes and learning rates are those of Table 3 of the OTC paper; the rest follows the
algorithms' own papers and code, as named in `otc_dist/algorithms/`.
"""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, PositiveInt

from otc_dist.description.section import Section
from otc_dist.errors import UserError
from otc_dist.spec import AgentSpec, Task


class CommonSection(Section):
    """What every base algorithm has.

    Attributes:
        tuning_updates: L, updates after each deployment (Table 3).
        has_q: whether d_q can be used.
        discrete: whether it is for discrete actions, otherwise for continuous ones.
        plans: whether it needs to be told the task.
    """

    tuning_updates: ClassVar[int]
    has_q: ClassVar[bool] = True
    discrete: ClassVar[bool] = False
    plans: ClassVar[bool] = False

    batch_size: int = Field(default=128, ge=1, description="transitions of an update")
    discount: float = Field(default=0.99, ge=0, lt=1, description="gamma, of a step")


class SmallSection(CommonSection):
    """Table 3's networks of 64 and 64."""

    tuning_updates: ClassVar[int] = 4000

    hidden: tuple[PositiveInt, ...] = Field(
        default=(64, 64), description="hidden layers of every network"
    )
    target_rate: float = Field(default=0.005, gt=0, le=1, description="tau of the target networks")


class LargeSection(CommonSection):
    """Table 3's networks of 256 and 256."""

    tuning_updates: ClassVar[int] = 2000

    hidden: tuple[PositiveInt, ...] = Field(
        default=(256, 256), description="hidden layers of every network"
    )


class BcqSection(SmallSection):
    """BCQ. What Table 3 leaves open is as in its authors' code."""

    name: Literal["bcq"] = "bcq"
    actor_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    critic_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    vae_learning_rate: float = Field(
        default=1e-3, gt=0, description="not in Table 3: BCQ's own code"
    )
    target_candidates: int = Field(default=10, ge=1, description="actions decoded for a target")
    acting_candidates: int = Field(default=100, ge=1, description="actions decoded to act")
    perturbation: float = Field(default=0.05, ge=0, description="phi, in units of the action bound")
    soft_minimum: float = Field(
        default=0.75, ge=0, le=1, description="weight of min in 0.75 min + 0.25 max"
    )


class AwacSection(SmallSection):
    """AWAC. What Table 3 leaves open is as in its authors' code, but for the temperature, and that
    states are standardised, as in CORL.
    """

    name: Literal["awac"] = "awac"
    actor_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    critic_learning_rate: float = Field(default=5e-4, gt=0, description="Table 3")
    weighting: Literal["softmax", "exponential"] = Field(
        default="softmax", description="softmax over the minibatch (rlkit) or exp up to 100 (CORL)"
    )
    temperature: float = Field(
        default=10.0, gt=0, description="of the advantages, in units of Q (rlkit: 2, CORL: 1)"
    )


class CqlSection(LargeSection):
    """CQL for continuous actions. What Table 3 leaves open is as in its authors' code, but that
    states are standardised and the actor is not warmed up by imitation, as in CORL.
    """

    name: Literal["cql"] = "cql"
    actor_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    critic_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    target_rate: float = Field(default=0.005, gt=0, le=1, description="tau of the target networks")
    weight: float = Field(
        default=10.0, ge=0, description="w of the conservative term (its authors: 5 or 10)"
    )
    action_samples: int = Field(
        default=10, ge=1, description="actions of each kind in the conservative term"
    )


class DiscreteCqlSection(LargeSection):
    """CQL for discrete actions."""

    discrete: ClassVar[bool] = True

    name: Literal["discrete-cql"] = "discrete-cql"
    critic_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    target_rate: float = Field(default=0.005, gt=0, le=1, description="tau of the target networks")
    weight: float = Field(
        default=1.0, ge=0, description="alpha of the conservative term, as in the published codes"
    )


class Td3BcSection(LargeSection):
    """TD3+BC. What Table 3 leaves open is as in its authors' code."""

    name: Literal["td3bc"] = "td3bc"
    actor_learning_rate: float = Field(default=3e-4, gt=0, description="Table 3")
    critic_learning_rate: float = Field(default=3e-4, gt=0, description="Table 3")
    target_rate: float = Field(default=0.005, gt=0, le=1, description="tau of the target networks")
    q_weight: float = Field(
        default=2.5, ge=0, description="alpha, weight of Q against imitation of the data"
    )


class BremenSection(LargeSection):
    """BREMEN. It has no Q, hence no d_q. docs/method.md compares it with its authors' code."""

    has_q: ClassVar[bool] = False
    plans: ClassVar[bool] = True

    name: Literal["bremen"] = "bremen"
    actor_learning_rate: float = Field(default=1e-4, gt=0, description="of the clone")
    model_learning_rate: float = Field(default=5e-4, gt=0, description="Table 3's of the critic")
    average_rate: float = Field(
        default=1e-3, gt=0, le=1, description="of the averages of the models' and clone's weights"
    )
    models: int = Field(default=5, ge=1, description="dynamics models in the ensemble")
    improvements: int = Field(
        default=50, ge=0, description="trust-region steps after each phase's updates"
    )
    horizon: int = Field(default=100, ge=1, description="steps of a rollout in the models")
    std: float = Field(default=0.1, gt=0, description="of the policy in rollouts")
    trace: float = Field(default=0.95, ge=0, le=1, description="lambda of the advantages (GAE)")
    radius: float = Field(
        default=0.01, gt=0, description="largest mean KL divergence of one step, nats"
    )


AlgorithmSection = Annotated[
    BcqSection | AwacSection | CqlSection | DiscreteCqlSection | Td3BcSection | BremenSection,
    Field(discriminator="name"),
]


def check_fit(section: AlgorithmSection, spec: AgentSpec, task: Task | None) -> None:
    """Refuse an algorithm for the other kind of actions, or one that plans and knows no task.

    Raises:
        UserError: it does not fit; the message says what does.
    """
    name = f"algorithm.name = {section.name!r}"
    if section.discrete != bool(spec.choices):
        has = f"{spec.choices} discrete actions" if spec.choices else "continuous actions"
        suited = "'discrete-cql'" if spec.choices else "for example 'bcq'"
        raise UserError(f"{name} does not fit {spec.name}, which has {has}; use {suited}")
    if section.plans and task is None:
        raise UserError(
            f"{name} plans in a model and needs the task's reward function, which this"
            " environment does not provide; use another algorithm"
        )
