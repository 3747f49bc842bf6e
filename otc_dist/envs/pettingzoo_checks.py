"""What a user's own environment does and gives, checked: each mistake is one line.

A line names the environment, what was found and what is expected; of what the user's code raised,
where it did so.
"""

import math
import reprlib
import textwrap
from collections.abc import Hashable, Iterator, Mapping, Set
from contextlib import contextmanager
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, Space, flatten
from numpy.typing import NDArray

from otc_dist.description.user_code import described
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32, all_finite

# What `ParallelEnv`'s calls return, each a dictionary by agent.
RETURNS = {
    "reset": ("observations", "infos"),
    "step": ("observations", "rewards", "terminations", "truncations", "infos"),
}

_SHOWN = 120  # characters of a space
_LARGEST = float(np.finfo(np.float32).max)


@contextmanager
def in_users_code(env_id: str, what: str) -> Iterator[None]:
    """Turn an exception of the user's code into a UserError that says where it was raised."""
    try:
        yield
    except UserError:
        raise
    except (Exception, SystemExit) as error:  # whatever the user's code raises
        raise UserError(f"{env_id}: {what} raised {described(error)}") from error


def returned(
    env_id: str, call: str, given: object, agents: Set[Hashable]
) -> tuple[Mapping[Hashable, Any], ...]:
    """What `reset` or `step` gave.

    Raises:
        UserError: it is not the dictionaries it must be, or one but the last, the infos, names
            somebody who is none of the `agents`.
    """
    names = RETURNS[call]
    parts = tuple(given) if isinstance(given, tuple | list) else (given,)
    if len(parts) != len(names) or not all(isinstance(part, Mapping) for part in parts):
        kinds = ", ".join(type(part).__name__ for part in parts)
        raise UserError(
            f"{env_id}: {call} gave ({kinds}); it must give {len(names)} dictionaries by agent:"
            f" {', '.join(names)}"
        )
    for name, part in zip(names[:-1], parts[:-1], strict=True):
        if unknown := part.keys() - agents:
            raise UserError(
                f"{env_id}: {call} gave {name} of {shown(min(unknown, key=str))}, which is none of"
                " its possible_agents"
            )
    return parts


def observation(env_id: str, name: str, space: Box | Discrete, seen: object) -> Float32:
    """An observation as a vector.

    Raises:
        UserError: it is not of its space's shape, or holds what float32 cannot.
    """
    if isinstance(space, Discrete):
        found, wanted = _array(flatten(space, seen) if space.contains(seen) else None), str(space)
    else:
        found, wanted = _array(seen), f"an array of shape {space.shape}"
        if found is not None and found.shape != space.shape:
            found = None
    if found is None:
        raise UserError(
            f"{env_id}: {name} observes {shown(seen)}; its observation_space says {wanted}"
        )
    with np.errstate(over="ignore"):
        vector = found.astype(np.float32).ravel()
    if not all_finite(vector):
        raise UserError(f"{env_id}: {name} observes NaN, infinity or more than float32 can hold")
    return vector


def mask(env_id: str, name: str, info: object, choices: int, last: bool) -> Float32:
    """Which of an agent's actions are available: all, where its info does not say.

    `last`: the episode has ended by itself, and nobody acts any more.

    Raises:
        UserError: a mask of another length, or none available although the agent must act.
    """
    given = info.get("action_mask") if isinstance(info, Mapping) else None
    if given is None:
        return np.ones(choices, np.float32)
    found = _array(given)
    if found is None or found.shape != (choices,):
        raise UserError(
            f"{env_id}: the action_mask of {name} is {shown(given)}; its {choices} actions need"
            f" an array of shape {(choices,)}"
        )
    if not np.isin(found, (0, 1)).all():
        raise UserError(f"{env_id}: the action_mask of {name} holds values other than 0 and 1")
    if not last and not (found > 0).any():
        raise UserError(
            f"{env_id}: the action_mask of {name} is all zero; at least one of its {choices}"
            " actions must be available until the episode terminates"
        )
    return found.astype(np.float32)


def reward(env_id: str, name: str, given: object) -> float:
    """A reward. Raises UserError if it is no number that float32 can hold."""
    found = number(given)
    if found is None:
        raise UserError(f"{env_id}: the reward of {name} is {shown(given)}; it must be a number")
    if not abs(found) <= _LARGEST:
        raise UserError(
            f"{env_id}: the reward of {name} is {found:g}; it must be finite, also in float32"
        )
    return found


def ended(env_id: str, name: str, what: str, given: object) -> bool:
    """Whether an agent's episode ended, by the dictionary `what`. UserError if it is no flag."""
    found = number(given)
    if found not in (0.0, 1.0):
        raise UserError(f"{env_id}: in {what}, {name} is {shown(given)}; it must be True or False")
    return bool(found)


def number(given: object) -> float | None:
    """A number, or an array of one, as float; None if it is none (a string, or several)."""
    if isinstance(given, bool | int | float):  # nearly always
        return _float(given)
    found = _array(given)
    return None if found is None or found.size != 1 else _float(found.item())


def _float(given: float) -> float:
    try:
        return float(given)
    except OverflowError:  # a whole number without end
        return math.inf if given > 0 else -math.inf


def _array(given: object) -> NDArray[Any] | None:
    """Numbers as an array; None if they are none."""
    try:
        found = np.asarray(given)
    except (TypeError, ValueError, RuntimeError):  # rows of different lengths, or another library's
        return None
    return found if found.dtype.kind in "biuf" else None


def shown(value: object) -> str:
    """A value of theirs in a few words, in one line."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}, {value.dtype}"
    if isinstance(value, Space):
        return textwrap.shorten(str(value), _SHOWN, placeholder=" ...")
    return " ".join(reprlib.repr(value).split())
