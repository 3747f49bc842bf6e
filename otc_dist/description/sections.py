"""The sections of a launch description, but for what is chosen by name: one class each."""

from typing import Literal, Self

from pydantic import (
    Field,
    PositiveInt,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from otc_dist.description.section import Section
from otc_dist.names import DatasetId, EnvironmentId

EngineName = Literal["auto", "compiled", "cuda-graph", "eager"]
ProductsName = Literal["auto", "own", "torch"]


class EnvSection(Section):
    """The task, and how many copies of it the env host steps together."""

    id: EnvironmentId = Field(description="environment, for example hopper-3x1")
    agents: PositiveInt | None = Field(
        default=None, description="of a task for any number: replaces the number in its id"
    )
    copies: int = Field(default=4, ge=1, description="E, environment copies stepping together")


class DatasetSection(Section):
    """The offline data B_0 of every agent."""

    name: DatasetId = Field(description="B_0, as hopper-3x1/medium-replay; its level alone will do")
    transitions: int = Field(
        default=0, ge=0, description="size of B_0; 0: the data set's usual size"
    )


class EmbeddingSection(Section):
    """The conditional VAE of the embedding distance d_e, trained on B_0 only, then frozen."""

    size: int = Field(default=10, ge=1, description="latent dimension (Table 3)")
    hidden: tuple[PositiveInt, ...] = Field(default=(64, 64), description="hidden layers")
    updates: int = Field(default=10_000, ge=1, description="on B_0")
    batch_size: int = Field(default=256, ge=1, description="transitions of an update")
    learning_rate: float = Field(default=1e-3, gt=0, description="Adam's")
    kl_weight: float = Field(default=1e-6, ge=0, description="small, or the latent collapses")
    minimum_active: int = Field(
        default=4, ge=0, description="warn below this many active dimensions"
    )


class DynamicsSection(Section):
    """The forward model of d_f and `typical`, trained on B_0 only, and d_f's correction of it."""

    hidden: tuple[PositiveInt, ...] = Field(default=(128, 128), description="hidden layers")
    updates: int = Field(default=5_000, ge=1, description="of each of its two networks")
    batch_size: int = Field(default=256, ge=1, description="transitions of an update")
    learning_rate: float = Field(default=1e-3, gt=0, description="Adam's")
    correction_hidden: tuple[PositiveInt, ...] = Field(
        default=(64, 64), description="hidden layers of the correction"
    )
    correction_updates: int = Field(
        default=500, ge=1, description="on D_k, of each of two networks, at most"
    )


class OfflineSection(Section):
    """Offline training to pi_0. Targets with tau 0.005 settle in tens of thousands of updates."""

    updates: int = Field(default=50_000, ge=0, description="offline updates to pi_0")
    rows: Literal["all", "typical"] = Field(
        default="all",
        description="typical: values are learned from those whose s' is nearest to what a forward"
        " model of B_0 expects; what imitates the data sees all",
    )
    share: float = Field(default=0.1, gt=0, le=1, description="of B_0 that counts as typical")
    policies: str = Field(
        default="",
        description="digest of policies pi_0 taken from another run, set by --from; empty: trained",
    )


class DeploymentSection(Section):
    """The K deployments and the tuning after each."""

    count: int = Field(default=10, ge=0, le=10_000, description="K, deployments")
    turns: bool = Field(
        default=False,
        description="agents tune in turns, one after each deployment: 1/N of all updates",
    )
    fraction: float = Field(default=0.01, gt=0, le=1, description="M as a share of |B_0|")
    transitions: int = Field(default=0, ge=0, description="M; 0: fraction of |B_0|")
    updates: int = Field(
        default=0,
        ge=0,
        description="L, updates after each deployment; 0: the algorithm's (Table 3)",
    )
    exploration: Literal["none", "sequential"] = Field(
        default="none",
        description="sequential: each agent in turn explores for M transitions of its own, N M in"
        " all, while the others exploit",
    )
    exploration_noise: float = Field(
        default=0.1, ge=0, description="standard deviation, in units of the action bound"
    )
    exploration_rate: float = Field(
        default=0.1, ge=0, le=1, description="share of random actions among discrete ones"
    )
    keep: Literal["best", "last"] | None = Field(
        default=None,
        description="the policy that is recommended in the end: the best deployed one, as the"
        " deployments measured them, or the last tuned one; unset: best where all agents get one"
        " reward and nobody explores, else last",
    )
    confirm: bool = Field(
        default=False,
        description="deploy the last tuned policy once more, so that it is measured as well",
    )
    revert: bool = Field(
        default=False, description="tuning continues from the best policy deployed so far"
    )
    floor: float | None = Field(
        default=None,
        allow_inf_nan=False,
        description="no deployment follows one whose measured return is below it; unset: none is",
    )
    approve: bool = Field(default=False, description="wait for a person before each deployment")
    rate_hz: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        description="steps a second, of devices that do not wait: where an answer is not there in"
        " time, the agent's action before is held; unset: each step waits for all answers",
    )
    reset_by_hand: bool = Field(
        default=False, description="with rate_hz: wait for a person before each episode"
    )

    @model_serializer(mode="wrap")
    def _as_before(self, plain: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Without what belongs to a clock where none is kept: digests are those of before."""
        found: dict[str, object] = plain(self)
        if self.rate_hz is None:
            found.pop("rate_hz", None)
        if not self.reset_by_hand:
            found.pop("reset_by_hand", None)
        return found

    @property
    def total(self) -> int:
        """Deployments in all: K, and the one that confirms pi_K."""
        return self.count + self.confirm

    @model_validator(mode="after")
    def _measurable(self) -> Self:
        if self.exploration != "none":
            asked = (
                ("keep = 'best'", self.keep == "best", ""),
                ("floor", self.floor is not None, ""),
                ("revert", self.revert, ": set deployment.revert=false"),
            )
            for what, wanted, way in asked:
                if wanted:
                    raise ValueError(
                        f"{what} needs exploration = 'none': an agent that explores does not act by"
                        f" its policy, which is then not measured{way}"
                    )
        if self.revert and self.keep == "last":
            raise ValueError(
                "revert needs keep = 'best', as it goes back to the best deployed policy: set"
                " deployment.revert=false"
            )
        if self.reset_by_hand and self.rate_hz is None:
            raise ValueError("reset_by_hand needs rate_hz: a simulator resets itself")
        return self


class EvaluationSection(Section):
    """Greedy episodes apart from the M collected steps; never seen by a learner."""

    episodes: int = Field(
        default=30, ge=0, description="greedy episodes after each tuning; 0: none"
    )


class EngineSection(Section):
    """What runs the update steps (otc_dist/steps/engine.py)."""

    name: EngineName = Field(default="auto", description="auto resolves before the run starts")
    products: ProductsName = Field(
        default="auto",
        description="who multiplies matrices in compiled code: own, a kernel that uses the widest"
        " vectors, by parts of torch that it does not promise to keep; or torch. auto resolves"
        " before the run starts: own where that works",
    )


class BusSection(Section):
    """How processes meet, and limits of the messages between them."""

    router: str = Field(
        default="",
        description="endpoint of a Zenoh router, as tls/192.0.2.1:7447, at which all processes meet"
        " instead of at the env host",
    )
    answer_deadline: float = Field(
        default=120.0,
        gt=0,
        description="seconds without a sign of life from a process before giving up",
    )
    maximum_payload: int = Field(
        default=16 * 2**20, ge=1024, description="bytes; larger is refused"
    )
