"""What a comparison compares: named sets of assignments to one description, and its seeds."""

from collections.abc import Iterable, Mapping, Sequence

from otc_dist.description import Description
from otc_dist.errors import UserError, unknown

Arms = dict[str, tuple[str, ...]]  # name -> `section.key=value` assignments

REFERENCE = "uniform"  # every arm is compared with it
NULL = "uniform-null"  # the reference with other minibatches: what chance alone does

_OTC = "sampling.name=otc"
_EMBEDDING = (_OTC, "sampling.distance=embedding")
_VALUE = (_OTC, "sampling.distance=value")
_CHANGE = (_OTC, "sampling.distance=change")
KNOWN: Arms = {
    "otc-embedding": _EMBEDDING,
    "otc-embedding-fixed": (*_EMBEDDING, "sampling.adaptive=false"),
    "otc-value": _VALUE,
    "otc-value-fixed": (*_VALUE, "sampling.adaptive=false"),
    "otc-value-paper": (*_VALUE, "sampling.normaliser=paper"),
    "otc-value-shared": (*_VALUE, "sampling.normaliser=shared"),
    "otc-change": _CHANGE,
    "otc-change-fixed": (*_CHANGE, "sampling.adaptive=false"),
    REFERENCE: ("sampling.name=uniform",),
    "online-only": ("sampling.name=online-only",),
    "balanced": ("sampling.name=balanced",),
    NULL: ("sampling.name=uniform", "minibatch_key=1"),
}
_USUAL = ("otc-embedding", "otc-value", "balanced", REFERENCE, "online-only")


def usual(base: Description) -> str:
    """The arms of a comparison that names none, comma-separated; d_q's only with a Q."""
    return ",".join(name for name in _USUAL if base.algorithm.has_q or KNOWN[name] != _VALUE)


def parse_arms(text: str, own: Iterable[str] = ()) -> Arms:
    """Arms by name, in order, with the reference and the null arm added if they are missing.

    Args:
        text: names, comma-separated.
        own: arms of the user's, each `name=section.key=value,section.key=value`.

    Raises:
        UserError: an unknown name (the nearest is suggested), or none at all.
    """
    mine = dict(_parse_own(item) for item in own)
    known = KNOWN | mine
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise UserError(f"no arm to compare; known: {', '.join(known)}")
    for name in names:
        if name not in known:
            raise unknown("arm", name, known)
    return {name: known[name] for name in dict.fromkeys([*names, *mine, REFERENCE, NULL])}


def _parse_own(text: str) -> tuple[str, tuple[str, ...]]:
    name, _, assignments = text.partition("=")
    if not name.replace("-", "").replace("_", "").isalnum() or "=" not in assignments:
        raise UserError(
            f"--arm {text!r}: write name=section.key=value,..., like"
            " mild=sampling.name=otc,sampling.alpha=0.5"
        )
    if name in KNOWN:
        raise UserError(f"--arm {text!r}: {name} is an arm already; choose another name")
    return name, tuple(assignments.split(","))


def parse_seeds(text: str) -> tuple[int, ...]:
    """`0..9` (both ends included), `0,1,5`, or both: `0..3,7`. Raises UserError."""
    seeds: list[int] = []
    for part in text.split(","):
        first, dots, last = part.strip().partition("..")
        try:
            low, high = int(first), int(last if dots else first)
        except ValueError:
            raise UserError(f"--seeds {text!r}: write 0..9 or 0,1,5") from None
        if low < 0 or high < low:
            raise UserError(f"--seeds {text!r}: {part.strip()!r} holds no seeds; write 0..9")
        seeds.extend(range(low, high + 1))
    return tuple(dict.fromkeys(seeds))


def describe(base: Description, assignments: Sequence[str], seed: int) -> Description:
    """The description of one run of an arm.

    Raises:
        UserError: the arm would change the offline policy, which all arms share.
    """
    description = base.with_assignments(*assignments, f"seed={seed}")
    if description.offline_digest() != of_seed(base, seed).offline_digest():
        raise UserError(
            f"an arm may not change how pi_0 is trained: {', '.join(assignments)};"
            " use --set, which is for all arms"
        )
    return description


def of_seed(base: Description, seed: int) -> Description:
    """How the offline policies of a seed are trained, with the embedding that d_e needs."""
    return base.with_assignments(*KNOWN["otc-embedding"], f"seed={seed}")


def check(base: Description, arms: Mapping[str, Sequence[str]]) -> None:
    """Build every arm once, so that a mistake shows before anything runs. Raises UserError."""
    for name, assignments in arms.items():
        try:
            describe(base, assignments, 0)
        except UserError as error:
            raise UserError(f"arm {name}: {error}") from None
