"""What a comparison compares: named sets of assignments to one description, and its seeds."""

from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter

from otc_dist.comparison import perfect
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.description import Description, user_code
from otc_dist.description.assignments import key_of
from otc_dist.description.kinds import STRATEGIES
from otc_dist.description.sampling import Arm
from otc_dist.envs import registry
from otc_dist.names import is_name
from otc_dist.otc.samplers.correction import share_of
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError, unknown

Arms = dict[str, tuple[str, ...]]  # name -> `section.key=value` assignments

REFERENCE = "uniform"  # every arm is compared with it
NULL = "uniform-null"  # the reference with other minibatches: what chance alone does
PERFECT = "perfect"  # an analysis: transitions as they would be with the others acting as now
ORACLE = "oracle"  # an analysis: the transitions in which the others acted most as they do now

_OF_STRATEGIES = {
    arm: meaning for name in STRATEGIES for arm, meaning in STRATEGIES.section(name).arms.items()
}
_UNIFORM = _OF_STRATEGIES[REFERENCE].assignments
_NULL = Arm(
    (*_UNIFORM, "minibatch_key=1"),
    "uniform with other minibatches: what chance alone does",
)
KNOWN: Arms = {name: arm.assignments for name, arm in _OF_STRATEGIES.items()} | {
    NULL: _NULL.assignments
}
MEANINGS = {name: arm.meaning for name, arm in _OF_STRATEGIES.items()} | {NULL: _NULL.meaning}
# What no learner can do: `analyses` makes these arms, and a single run cannot take them.
ANALYSES: Arms = {PERFECT: _UNIFORM, ORACLE: share_of("random")}
MOST_SEEDS = 1000  # of one range; more is a slip of the finger
# The arms of a comparison that names none.
USUAL = ("dynamics-share", "typical-share", "random-share", "rlpd", REFERENCE)


def parse_arms(text: str, own: Iterable[str] = ()) -> Arms:
    """Arms by name, in order, with the reference and the null arm added if they are missing.

    Args:
        text: names, comma-separated.
        own: arms of the user's, each `name=section.key=value,section.key=value`.

    Raises:
        UserError: an unknown name (the nearest is suggested), or none at all.
    """
    mine: Arms = {}
    for name, assignments in map(_parse_own, own):
        if name in mine:
            raise UserError(f"--arm {name} is given twice: choose another name")
        mine[name] = assignments
    known = KNOWN | ANALYSES | mine
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise UserError(f"no arm to compare; known: {', '.join(known)}")
    for name in names:
        if name not in known:
            raise unknown("arm", name, known)
    return {name: known[name] for name in dict.fromkeys([*names, *mine, REFERENCE, NULL])}


def of_single_run(name: str) -> tuple[str, ...]:
    """The assignments of an arm that a single run can take.

    Raises:
        UserError: an unknown name (the nearest is suggested), or one of an analysis.
    """
    if name in ANALYSES:
        raise UserError(
            f"arm {name} looks at all agents' data and policies, which no run may: it is an arm of"
            " `launch compare` only"
        )
    if name not in KNOWN:
        raise unknown("arm", name, KNOWN)
    return KNOWN[name]


def _parse_own(text: str) -> tuple[str, tuple[str, ...]]:
    name, _, assignments = text.partition("=")
    if not is_name(name) or "=" not in assignments:
        raise UserError(
            f"--arm {text!r}: write name=section.key=value,..., like"
            " strict=sampling.name=otc,sampling.share=0.02"
        )
    if name in KNOWN or name in ANALYSES:
        raise UserError(f"--arm {text!r}: {name} is an arm already; choose another name")
    assigned = tuple(assignments.split(","))
    keys = [key_of(one) for one in assigned if "=" in one]
    if twice := [key for key in keys if keys.count(key) > 1]:
        raise UserError(f"--arm {text!r}: {twice[0]} is given twice")
    if "seed" in keys:
        raise UserError(f"--arm {text!r}: all arms have the seeds of --seeds; leave it out")
    trust(assigned)
    return name, assigned


def trust(assignments: Iterable[str]) -> None:
    """Allow the code that assignments of the user's name."""
    user_code.allow(*(text.partition("=")[2].strip(" '\"") for text in assignments))


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
        if high - low >= MOST_SEEDS:
            raise UserError(f"--seeds {text!r}: more than {MOST_SEEDS:,} seeds at once")
        seeds.extend(range(low, high + 1))
    return tuple(dict.fromkeys(seeds))


# What all arms have in common: else their episodes, or their deployments, cannot be compared.
_COMMON = ("env", "dataset", "evaluation", "engine", "deployment.count", "seed")
_SINGLE = ("confirm", "floor", "approve")  # settings that would end a run differently from others


def describe(base: Description, assignments: Sequence[str], seed: int) -> Description:
    """The description of one run of an arm.

    Raises:
        UserError: the arm would change what all arms have in common.
    """
    description, shared = base.with_assignments(*assignments, f"seed={seed}"), of_seed(base, seed)
    for name in _COMMON:
        value = attrgetter(name)
        if value(description) != value(shared):
            raise UserError(
                f"an arm may not change {name}, which all arms share: {', '.join(assignments)};"
                " use --set, which is for all arms"
            )
    return description


def of_seed(base: Description, seed: int) -> Description:
    """How the offline policies of a seed are trained, where an arm does not say otherwise."""
    return base.with_assignments(f"seed={seed}")


def offline_files(
    folder: ComparisonFolder, base: Description, description: Description
) -> RunFolder:
    """Where pi_0 of a run lies: the one that is shared, or one that its arm trains for itself."""
    seed, digest = description.seed, description.offline_digest()
    shared = of_seed(base, seed).offline_digest()
    return folder.seed(seed) if digest == shared else folder.own(seed, digest)


def check(base: Description, arms: Mapping[str, Sequence[str]]) -> None:
    """Build every arm once, so that a mistake shows before anything runs. Raises UserError."""
    for name, assignments in arms.items():
        try:
            description = describe(base, assignments, 0)
            for key in _SINGLE:
                if getattr(description.deployment, key):
                    raise UserError(f"deployment.{key} is for single runs: leave it out")
            if name in ANALYSES:
                _check_analysis(name, description)
        except UserError as error:
            raise UserError(f"arm {name}: {error}") from None


def _check_analysis(name: str, description: Description) -> None:
    env_id = description.env.id
    if len(registry.team_spec(env_id).agents) < 2:
        raise UserError(f"it is about other agents, and {env_id} has none")
    if description.deployment.exploration != "none":
        raise UserError(
            "it needs deployment.exploration = 'none': what an agent that explores does is not"
            " what it would do"
        )
    if name == PERFECT:
        perfect.check(env_id)
