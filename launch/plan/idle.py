"""Settings that nothing obeys: who writes one on the command line expects something of it.

A file may hold them, as it holds the settings of strategies that it does not choose.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from otc_dist.description import Description
from otc_dist.description.assignments import assign, key_of
from otc_dist.names import is_code
from otc_dist.terminal.errors import UserError

# Setting -> which other one decides whether it is obeyed, and by which value.
_OBEYED_BY: dict[str, tuple[str, object]] = {
    "deployment.fraction": ("deployment.transitions", 0),
    "deployment.exploration_noise": ("deployment.exploration", "sequential"),
    "deployment.exploration_rate": ("deployment.exploration", "sequential"),
    "offline.share": ("offline.rows", "typical"),
    "sampling.alpha": ("sampling.acceptance", "rank"),
    "sampling.adaptive": ("sampling.acceptance", "rank"),
    "sampling.alpha_bound": ("sampling.acceptance", "rank"),
    "sampling.with_replacement": ("sampling.acceptance", "rank"),
    "sampling.share": ("sampling.acceptance", "share"),
    "sampling.level": ("sampling.acceptance", "conformal"),
    "sampling.normaliser": ("sampling.distance", "value"),
}

_SAID = "each of them says it itself"


def check(assignments: Iterable[str], description: Description) -> None:
    """See that a run obeys what its command line sets.

    Args:
        description: with these assignments, as it is run but for sizes that are not fixed yet.

    Raises:
        UserError: it does not.
    """
    for key in _keys(assignments):
        if why := _why(key, description):
            raise UserError(f"{key} has no effect: {why}; leave it out")


def check_begun(assignments: Iterable[str]) -> None:
    """The same of a run that begins with the policies pi_0 of another (`--from`)."""
    if idle := [key for key in _keys(assignments) if key.startswith("offline.")]:
        raise UserError(
            f"{idle[0]} has no effect: --from takes pi_0 from another run, and trains none;"
            " leave it out"
        )


def check_compared(
    assignments: Iterable[str],
    loaded: Description,
    arms: Mapping[str, Sequence[str]],
    own: Iterable[str],
) -> None:
    """The same of a comparison, some arm of which must obey it.

    Args:
        loaded: the description with the assignments.
        arms: name -> what it assigns further.
        own: names of those that the command line makes.
    """
    described = {name: loaded.with_assignments(*added) for name, added in arms.items()}
    for name in own:
        try:
            check(arms[name], described[name])
        except UserError as error:
            raise UserError(f"arm {name}: {error}") from None
    for key in _keys(assignments):
        why = {
            _SAID if key in map(key_of, added) else _why(key, described[name])
            for name, added in arms.items()
        }
        if None not in why:
            reason = min(filter(None, why - {_SAID}), default=_SAID)
            raise UserError(f"--set {key} has no effect on any of the arms: {reason}; leave it out")


def _keys(assignments: Iterable[str]) -> Iterator[str]:
    """`section.key` of each value that they set, also where one sets a whole section."""
    written: dict[str, object] = {}
    for assignment in assignments:
        assign(written, assignment)
    for section, values in written.items():
        yield from (f"{section}.{key}" for key in values) if isinstance(values, dict) else ()


def _why(key: str, description: Description) -> str | None:
    """Why a setting does nothing; None: it is obeyed, as far as is known."""
    if key not in _OBEYED_BY:
        return None
    decides, value = _OBEYED_BY[key]
    section, name = decides.split(".")
    of_section = getattr(description, section)
    chosen = getattr(of_section, name, None)
    if chosen is None:  # of another strategy
        decides, chosen = "sampling.name", description.sampling.name
    if chosen == value or is_code(str(chosen)):  # code of the user's own may have the same
        return None
    return f"it is for {_OBEYED_BY[key][0]} = {value!r}, and {decides} is {chosen!r}"
