"""OTC, the paper's online transition correction: what is like the newest deployment's transitions.

A distance says how unlike them a transition is, and a rule of acceptance what follows from it; any
of them go together.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from otc_dist.description.algorithms import AlgorithmSection
from otc_dist.description.distances import DISTANCES, facts_of
from otc_dist.description.kinds import STRATEGIES
from otc_dist.description.sampling import Arm, Cost, SamplingSection
from otc_dist.names import is_code
from otc_dist.otc.samplers.mixing import ImitatingAll, with_online

if TYPE_CHECKING:
    from otc_dist.description import Description
    from otc_dist.otc.distances.interface import Setting
    from otc_dist.otc.samplers.interface import Sampler

NormaliserName = Literal["relative", "shared", "paper"]

_RANK = ("sampling.name=otc", "sampling.acceptance=rank")
_SHARE = ("sampling.name=otc", "sampling.acceptance=share", "sampling.share=0.1")
_PAPER = ("sampling.corrects=all", "sampling.normaliser=paper", "sampling.with_replacement=true")


class Rule(NamedTuple):
    """A rule of acceptance: the `module:function` that makes a sampler by it, and its meaning."""

    place: str
    meaning: str


_RULES = "otc_dist.otc.acceptance"
ACCEPTANCES = {
    "rank": Rule(f"{_RULES}.rank:create", "Eq. 3, by the rank in a minibatch"),
    "share": Rule(f"{_RULES}.share:create", "the best share of B_k"),
    "conformal": Rule(f"{_RULES}.conformal:create", "what D_k itself could have looked like"),
}


def _one_of(known: Iterable[str]) -> AfterValidator:
    """One of those, or code of the user's own."""

    def check(name: str) -> str:
        if name not in known and not is_code(name):
            expected = ", ".join(map(repr, known))
            raise PydanticCustomError(
                "literal_error", "must be one of {expected}", {"expected": expected}
            )
        return name

    return AfterValidator(check)


DistanceName = Annotated[str, _one_of(DISTANCES)]
AcceptanceName = Annotated[str, _one_of(ACCEPTANCES)]


def of(distance: str, *assignments: str) -> tuple[str, ...]:
    """The assignments of an arm by that distance, and without online data beside what it accepts,
    whatever a description has.
    """
    return (*assignments, f"sampling.distance={distance}", "sampling.online_share=0")


def share_of(distance: str) -> tuple[str, ...]:
    """The assignments of the arm that accepts a tenth by that distance."""
    return of(distance, *_SHARE)


_ARMS = {
    **{
        f"otc-{name}": Arm(of(name, *_RANK), f"OTC by rank (Eq. 3), {facts.title}: {facts.meaning}")
        for name, facts in DISTANCES.items()
        if name != "random"
    },
    **{
        f"{name}-share": Arm(
            share_of(name), f"the tenth of B_k that is nearest by {facts.title}: {facts.meaning}"
        )
        for name, facts in DISTANCES.items()
    },
    "otc-embedding-fixed": Arm(
        of("embedding", *_RANK, "sampling.adaptive=false"),
        "otc-embedding, with alpha as it is at first",
    ),
    "otc-value-fixed": Arm(
        of("value", *_RANK, "sampling.adaptive=false"), "otc-value, with alpha as it is at first"
    ),
    "otc-value-shared": Arm(
        of("value", *_RANK, "sampling.normaliser=shared"),
        "otc-value, with one normaliser for V(s') and its match's",
    ),
    "paper-embedding": Arm(
        of("embedding", *_RANK, *_PAPER),
        "otc-embedding as the paper has it: what imitates sees the same batch",
    ),
    "paper-embedding-fixed": Arm(
        of("embedding", *_RANK, *_PAPER, "sampling.adaptive=false"),
        "paper-embedding, with alpha as it is at first",
    ),
    "paper-value": Arm(
        of("value", *_RANK, *_PAPER), "otc-value as the paper has it, its normaliser too"
    ),
    "paper-value-fixed": Arm(
        of("value", *_RANK, *_PAPER, "sampling.adaptive=false"),
        "paper-value, with alpha as it is at first",
    ),
    "dynamics-conformal": Arm(
        of("dynamics", "sampling.name=otc", "sampling.acceptance=conformal"),
        "d_f, accepting what the newest deployment itself could have held",
    ),
}


class CorrectionSection(SamplingSection):
    """OTC (Algorithm 1, lines 10 to 14)."""

    arms: ClassVar[Mapping[str, Arm]] = _ARMS

    name: Literal["otc"] = "otc"
    distance: DistanceName = Field(
        default="typical",
        description="; ".join(f"{name}: {facts.meaning}" for name, facts in DISTANCES.items()),
    )
    acceptance: AcceptanceName = Field(
        default="share",
        description="; ".join(f"{name}: {rule.meaning}" for name, rule in ACCEPTANCES.items()),
    )
    corrects: Literal["values", "all"] = Field(
        default="values",
        description="values: what imitates the data sees a plain sample of B_k; all: the paper's",
    )
    share: float = Field(default=0.1, gt=0, le=1, description="of B_k that `share` accepts")
    level: float = Field(
        default=0.01,
        gt=0,
        lt=1,
        description="p-value from which `conformal` accepts a row for sure",
    )
    online_share: float = Field(
        default=0.0, ge=0, lt=1, description="of every batch that is D_1 .. D_k's (RLPD: 0.5)"
    )
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
        default=20_000, ge=1, description="rows of B that Eq. 4 uses with d_e and d_c"
    )

    @property
    def matches_minibatches(self) -> bool:
        """Whether distances change from update to update: by a minibatch D, or with Q."""
        return self.matching == "minibatch" or facts_of(self.distance).needs_q

    @property
    def code(self) -> tuple[str, ...]:
        return self.name, self.distance, self.acceptance

    @property
    def compared(self) -> str:
        return self.distance

    @property
    def title(self) -> str:
        return f"OTC, {facts_of(self.distance).title} by {self.acceptance}"

    @property
    def cost(self) -> Cost:
        facts = facts_of(self.distance)
        within = facts.per_update and self.acceptance == "rank" and self.matches_minibatches
        return Cost(update=facts.selection) if within else Cost(scoring=facts.scoring)

    def check(self, algorithm: AlgorithmSection, deployed: int) -> None:
        if facts_of(self.distance).needs_q and not algorithm.has_q:
            raise ValueError(
                f"sampling.distance = {self.distance!r} needs a Q, and"
                f" {algorithm.name} has none; use 'embedding'"
            )
        if self.acceptance == "conformal" and 0 < deployed < math.ceil(1 / self.level) - 1:
            raise ValueError(
                f"sampling.level = {self.level:g} needs deployments of at least"
                f" {math.ceil(1 / self.level) - 1} transitions, not {deployed}: no p-value"
                " among fewer is as small"
            )
        batch = algorithm.batch_size
        if self.acceptance == "rank" and not batch <= self.candidates:
            raise ValueError(
                f"algorithm.batch_size ({batch}) must not exceed sampling.candidates"
                f" ({self.candidates}), from which it is drawn"
            )


def settings_of(description: Description) -> CorrectionSection:
    """How a description says to correct, also where it chooses another strategy: the settings of a
    comparison's arms stand in it, and distances have some of them.
    """
    sampling = description.sampling
    if not isinstance(sampling, CorrectionSection):
        sampling = STRATEGIES.chosen({**sampling.model_dump(), "name": "otc"})
    assert isinstance(sampling, CorrectionSection)
    return sampling


class Correction:
    """OTC."""

    Section: ClassVar[type[SamplingSection]] = CorrectionSection

    @classmethod
    def create(cls, settings: CorrectionSection, setting: Setting, capacity: int) -> Sampler:
        # These have torch.
        from otc_dist.otc.acceptance import acceptance
        from otc_dist.otc.distances import create_distance

        def chosen(count: int) -> Sampler:
            distance = create_distance(settings.distance, setting)
            return acceptance(settings.acceptance)(distance, settings, count)

        batch = setting.description.algorithm.batch_size
        sampler = with_online(chosen, settings.online_share, batch)
        return ImitatingAll(sampler, batch) if settings.corrects == "values" else sampler
