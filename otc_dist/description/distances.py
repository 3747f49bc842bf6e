"""The distances by which OTC can sample: their names, and what can be said of them without torch.

A new distance is a file in `otc_dist/otc/distances/` and an entry here.
"""

from dataclasses import dataclass, field

from otc_dist.description import user_code


@dataclass(frozen=True)
class DistanceFacts:
    """What launchers, forecasts and comparisons know of a distance.

    Attributes:
        place: `module:class` of its implementation.
        title: how tables call it.
        meaning: one line for people.
        fits: the section of the description that says what it fits to B_0; None: nothing.
        fit_update: milliseconds of one update of that fit, compiled.
        selection: milliseconds that one update of the policy takes longer, where distances are
            computed at every update.
        scoring: milliseconds to score a thousand transitions, once a deployment.
        rows: rows of the mechanism check: title -> `sampling.key=value` assignments.
        needs_q: whether the algorithm must have a Q.
        per_update: whether it can be computed within the minibatches of one update, as in
            Algorithm 1; others are scores of the whole B_k, once a deployment.
    """

    place: str
    title: str
    meaning: str
    fits: str | None = None
    fit_update: float = 0.0
    selection: float = 0.0
    scoring: float = 0.0
    rows: dict[str, tuple[str, ...]] = field(default_factory=dict)
    needs_q: bool = False
    per_update: bool = False


# What samplers report before a deployment's updates. Of acceptance by rank: alpha and 𝔻 (Eq. 4); of
# the others: the share of B_k that is accepted.
SAMPLER_METRICS = ("alpha", "similarity", "accepted")
_HERE = "otc_dist.otc.distances"

DISTANCES: dict[str, DistanceFacts] = {
    "embedding": DistanceFacts(
        f"{_HERE}.embedding:EmbeddingDistance",
        "d_e",
        "the paper's: to the nearest online transition, in an embedding of (s, a, s')",
        fits="embedding",
        fit_update=0.6,
        selection=0.5,
        scoring=8.0,
        per_update=True,
    ),
    "value": DistanceFacts(
        f"{_HERE}.value:ValueDistance",
        "d_q",
        "the paper's: between the values of s' and of the best match's s', matched by Q(s, a)",
        selection=0.8,
        scoring=1.0,
        rows={
            f"d_q, {name}": (f"sampling.normaliser={name}",)
            for name in ("paper", "shared", "relative")
        },
        needs_q=True,
        per_update=True,
    ),
    "change": DistanceFacts(
        f"{_HERE}.change:ChangeDistance",
        "d_c",
        "between s' - s and that of the nearest online transition by (s, a)",
        selection=1.0,
        scoring=20.0,
        per_update=True,
    ),
    "dynamics": DistanceFacts(
        f"{_HERE}.dynamics:DynamicsDistance",
        "d_f",
        "from the s' that a forward model of B_0, corrected on D_k, expects",
        fits="dynamics",
        fit_update=1.5,
        scoring=1.5,
    ),
    "typical": DistanceFacts(
        f"{_HERE}.typical:TypicalDistance",
        "typical",
        "from the s' that a forward model of B_0 expects; no online data",
        fits="dynamics",
        fit_update=1.5,
    ),
    "random": DistanceFacts(
        f"{_HERE}.random:RandomDistance",
        "random",
        "a random number per deployment: the control of all others",
    ),
}


# Sections of the description, and phases of a learner, of what distances fit.
FITS = tuple(dict.fromkeys(facts.fits for facts in DISTANCES.values() if facts.fits))


def facts_of(name: str) -> DistanceFacts:
    """What is known of a distance. One of the user's own says it in `facts`, if it does, and only
    where it may be loaded.
    """
    if name in DISTANCES:
        return DISTANCES[name]
    found = user_code.named(name) if user_code.allowed(name) else None
    facts: DistanceFacts = getattr(found, "facts", DistanceFacts(name, name, "a user's own"))
    return facts
