"""The launch description: everything a run depends on, typed, validated, TOML in and out.

The same description and seed give the same run, to the byte.
"""

import hashlib
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Literal, Self

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, PositiveInt, ValidationError, model_validator
from pydantic_core import ErrorDetails

from otc_dist.errors import UserError, unknown

EngineName = Literal["auto", "compiled", "cuda-graph", "eager"]
SamplingName = Literal["otc", "uniform", "online-only"]
DistanceName = Literal["embedding", "value"]
NormaliserName = Literal["relative", "shared", "paper"]


class Section(BaseModel):
    """A section of the description: unknown keys, infinities and NaN are refused; it is frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class EnvSection(Section):
    """The task, and how many copies of it the env host steps together."""

    id: str = Field(description="environment, for example hopper-3x1")
    copies: int = Field(default=4, ge=1, description="E, environment copies stepping together")


class DatasetSection(Section):
    """The offline data B_0 of every agent."""

    name: str = Field(description="B_0, for example hopper-3x1/medium-replay")
    transitions: int = Field(
        default=0, ge=0, description="size of B_0; 0: the data set's usual size"
    )


class AlgorithmSection(Section):
    """Base algorithm. Sizes and rates from Table 3 of the paper; the rest as in BCQ's code."""

    name: Literal["bcq"] = "bcq"
    hidden: tuple[PositiveInt, ...] = Field(
        default=(64, 64), description="hidden layers of every network"
    )
    actor_learning_rate: float = Field(default=1e-4, gt=0)
    critic_learning_rate: float = Field(default=1e-4, gt=0)
    vae_learning_rate: float = Field(
        default=1e-3, gt=0, description="not in Table 3: BCQ's own code"
    )
    discount: float = Field(default=0.99, ge=0, lt=1)
    batch_size: int = Field(default=128, ge=1)
    target_rate: float = Field(default=0.005, gt=0, le=1, description="tau of the target networks")
    target_candidates: int = Field(default=10, ge=1, description="actions decoded for a target")
    acting_candidates: int = Field(default=100, ge=1, description="actions decoded to act")
    perturbation: float = Field(default=0.05, ge=0, description="phi, in units of the action bound")
    soft_minimum: float = Field(
        default=0.75, ge=0, le=1, description="weight of min in 0.75 min + 0.25 max"
    )


class EmbeddingSection(Section):
    """The conditional VAE of the embedding distance d_e, trained on B_0 only, then frozen."""

    size: int = Field(default=10, ge=1, description="latent dimension (Table 3)")
    hidden: tuple[PositiveInt, ...] = Field(default=(64, 64))
    updates: int = Field(default=10_000, ge=1)
    batch_size: int = Field(default=256, ge=1)
    learning_rate: float = Field(default=1e-3, gt=0)
    kl_weight: float = Field(default=1e-6, ge=0, description="small, or the latent collapses")
    minimum_active: int = Field(
        default=4, ge=0, description="warn below this many active dimensions"
    )


class SamplingSection(Section):
    """How minibatches are drawn from B_k while tuning (Algorithm 1, lines 10 to 14)."""

    name: SamplingName = "otc"
    distance: DistanceName = Field(default="embedding", description="d_e or d_q")
    matching: Literal["minibatch", "exact"] = Field(
        default="minibatch",
        description="match against a minibatch D (the paper) or against all of D_k",
    )
    candidates: int = Field(default=512, ge=1, description="|B|, Table 3")
    references: int = Field(default=2000, ge=1, description="|D|, Table 3")
    alpha: float = Field(default=1.0, ge=0, description="alpha_0")
    adaptive: bool = Field(default=True, description="adapt alpha at each deployment (Eq. 4)")
    alpha_bound: float = Field(default=0.0, ge=0, description="upper bound on alpha; 0: none")
    with_replacement: bool = Field(default=False, description="sample Eq. 3 with replacement")
    exclude_self: bool = Field(
        default=False, description="D_k's own transitions never match themselves"
    )
    normaliser: NormaliserName = Field(default="relative", description="of V(s') in d_q")
    value_samples: int = Field(default=1, ge=1, description="actions a value V(s') is the mean of")
    similarity_sample: int = Field(
        default=20_000, ge=1, description="rows of B that Eq. 4 uses with d_e"
    )


class OfflineSection(Section):
    """Offline training to pi_0. Targets with tau 0.005 settle in tens of thousands of updates."""

    updates: int = Field(default=100_000, ge=0, description="offline updates to pi_0")


class DeploymentSection(Section):
    """The K deployments and the tuning after each."""

    count: int = Field(default=10, ge=0, description="K, deployments")
    fraction: float = Field(default=0.01, gt=0, le=1, description="M as a share of |B_0|")
    transitions: int = Field(default=0, ge=0, description="M; 0: fraction of |B_0|")
    updates: int = Field(
        default=4000, ge=0, description="L, updates after each deployment (Table 3)"
    )


class EvaluationSection(Section):
    """Greedy episodes apart from the M collected steps; never seen by a learner."""

    episodes: int = Field(
        default=30, ge=0, description="greedy episodes after each tuning; 0: none"
    )


class EngineSection(Section):
    """What runs the update steps (otc_dist/engine.py)."""

    name: EngineName = Field(default="auto", description="auto resolves before the run starts")


class BusSection(Section):
    """Limits of the messages between processes."""

    answer_deadline: float = Field(
        default=120.0,
        gt=0,
        description="seconds without a sign of life from a process before giving up",
    )
    maximum_payload: int = Field(
        default=16 * 2**20, ge=1024, description="bytes; larger is refused"
    )


class Description(Section):
    """A whole run. `launch/*.toml` are descriptions; the run folder keeps the resolved one."""

    name: str
    summary: str = ""
    seed: int = Field(default=0, ge=0, lt=2**31)
    minibatch_key: int = Field(default=0, ge=0, description="other minibatches while tuning")
    env: EnvSection
    dataset: DatasetSection
    algorithm: AlgorithmSection = AlgorithmSection()
    embedding: EmbeddingSection = EmbeddingSection()
    sampling: SamplingSection = SamplingSection()
    offline: OfflineSection = OfflineSection()
    deployment: DeploymentSection = DeploymentSection()
    evaluation: EvaluationSection = EvaluationSection()
    engine: EngineSection = EngineSection()
    bus: BusSection = BusSection()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        batch = self.algorithm.batch_size
        if self.sampling.name == "otc" and not batch <= self.sampling.candidates:
            raise ValueError(
                f"algorithm.batch_size ({batch}) must not exceed sampling.candidates"
                f" ({self.sampling.candidates}), from which it is drawn"
            )
        return self

    @classmethod
    def load(cls, path: Path, assignments: Iterable[str] = ()) -> Self:
        """Read a TOML file and apply `section.key=value` assignments.

        Raises:
            UserError: the file is missing, is no TOML, or holds an unknown key or a bad value.
        """
        try:
            data = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise UserError(f"cannot read the description {path}: {error.strerror}") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise UserError(f"{path} is not valid TOML: {error}") from None
        return cls.build(data, assignments, source=str(path))

    @classmethod
    def build(
        cls, data: dict[str, object], assignments: Iterable[str] = (), source: str = "description"
    ) -> Self:
        """Validate `data` after `section.key=value` assignments; errors as in `load`."""
        merged: dict[str, object] = dict(data)
        for assignment in assignments:
            _assign(merged, assignment)
        try:
            return cls.model_validate(merged)
        except ValidationError as error:
            raise _explain(error.errors()[0], source) from None

    def with_assignments(self, *assignments: str) -> Self:
        """A copy with `section.key=value` assignments applied; errors as in `load`."""
        return self.build(self.model_dump(mode="json"), assignments)

    def to_toml(self) -> str:
        return tomli_w.dumps(self.model_dump(mode="json"))

    def digest(self) -> str:
        """Identifies the description: 16 hexadecimal digits of its canonical form's hash."""
        return _hash(self.model_dump_json())

    def offline_digest(self) -> str:
        """Identifies what the offline policy pi_0 depends on, as `digest` does the whole."""
        parts = {"seed", "dataset", "algorithm", "embedding", "offline", "engine"}
        return _hash(self.model_dump_json(include=parts) + self.env.id)


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _assign(data: dict[str, object], assignment: str) -> None:
    path, equals, text = assignment.partition("=")
    *sections, key = path.strip().split(".")
    if not equals or not key:
        raise UserError(f"--set {assignment!r}: write section.key=value, like sampling.alpha=0.5")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()  # a bare word is a string
    target = data
    for section in sections:
        below = target.get(section, {})
        if not isinstance(below, dict):
            raise UserError(f"--set {assignment!r}: {section!r} is a value, not a section")
        target[section] = below = dict(below)
        target = below
    target[key] = value


def _explain(problem: ErrorDetails, source: str) -> UserError:
    *sections, key = [str(part) for part in problem["loc"]] or [""]
    where = ".".join([*sections, key])
    if problem["type"] == "extra_forbidden":
        known = _fields(sections)
        return UserError(
            f"{source}: {unknown('key', where, ['.'.join([*sections, k]) for k in known])}"
        )
    if problem["type"] == "literal_error":
        known = re.findall(r"'([^']*)'", problem.get("ctx", {}).get("expected", ""))
        return UserError(f"{source}: {unknown(where, str(problem['input']), known)}")
    if problem["type"] == "missing":
        return UserError(f"{source}: {where} is missing; every description needs it")
    message = problem["msg"].removeprefix("Value error, ")
    given = f", not {problem['input']!r}" if key and problem["type"] != "value_error" else ""
    message = message[0].lower() + message[1:]
    return UserError(f"{source}: {where + ': ' if where else ''}{message}{given}")


def _fields(sections: list[str]) -> list[str]:
    model: type[BaseModel] = Description
    for section in sections:
        annotation = model.model_fields[section].annotation
        if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            return []
        model = annotation
    return list(model.model_fields)
