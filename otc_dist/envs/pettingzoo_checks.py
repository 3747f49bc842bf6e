"""What a user's own environment does and gives, checked: each mistake is one line.

A line names the environment, what was found and what is expected; of what the user's code raised,
where it did so.
"""

import reprlib
import sysconfig
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, flatten

from otc_dist.errors import UserError
from otc_dist.transitions import Float32

# What `ParallelEnv`'s calls return, each a dictionary by agent.
RETURNS = {
    "reset": ("observations", "infos"),
    "step": ("observations", "rewards", "terminations", "truncations", "infos"),
}

_OURS = Path(__file__).parent
_INSTALLED = tuple({Path(path) for path in sysconfig.get_paths().values()})


@contextmanager
def in_users_code(env_id: str, what: str) -> Iterator[None]:
    """Turn an exception of the user's code into a UserError that says where it was raised."""
    try:
        yield
    except UserError:
        raise
    except Exception as error:  # whatever the user's code raises
        raise UserError(f"{env_id}: {what} raised {described(error)}") from error


def described(error: Exception) -> str:
    """The exception's type and message, and the place in the user's code that raised it."""
    said = " ".join(str(error).split())
    text = f"{type(error).__name__}: {said}" if said else type(error).__name__
    # What is below the user's last line are packages that it called.
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith("<") and not Path(frame.filename).is_relative_to(_OURS)
    ]
    own = [
        frame
        for frame in frames
        if not any(Path(frame.filename).is_relative_to(folder) for folder in _INSTALLED)
    ]
    place = (own or frames)[-1:]
    return f"{text} ({place[0].filename}:{place[0].lineno})" if place else text


def returned(env_id: str, call: str, given: object) -> tuple[Mapping[str, Any], ...]:
    """What `reset` or `step` gave. Raises UserError if it is not the dictionaries it must be."""
    names = RETURNS[call]
    parts = tuple(given) if isinstance(given, tuple | list) else (given,)
    if len(parts) == len(names) and all(isinstance(part, Mapping) for part in parts):
        return parts
    kinds = ", ".join(type(part).__name__ for part in parts)
    raise UserError(
        f"{env_id}: {call} gave ({kinds}); it must give {len(names)} dictionaries by agent:"
        f" {', '.join(names)}"
    )


def observation(env_id: str, name: str, space: Box | Discrete, seen: object) -> Float32:
    """An observation as a vector. Raises UserError if it is not of its space's shape."""
    if isinstance(space, Discrete):
        fits, wanted = space.contains(seen), str(space)
    else:
        wanted = f"an array of shape {space.shape}"
        try:
            fits = np.asarray(seen, space.dtype).shape == space.shape
        except (TypeError, ValueError):  # no numbers, or rows of different lengths
            fits = False
    if not fits:
        raise UserError(
            f"{env_id}: {name} observes {_shown(seen)}; its observation_space says {wanted}"
        )
    return np.asarray(flatten(space, seen), np.float32)


def mask(env_id: str, name: str, info: object, choices: int, last: bool) -> Float32:
    """Which of an agent's actions are available: all, where its info does not say.

    `last`: the episode has ended by itself, and nobody acts any more.

    Raises:
        UserError: a mask of another length, or none available although the agent must act.
    """
    given = info.get("action_mask") if isinstance(info, Mapping) else None
    if given is None:
        return np.ones(choices, np.float32)
    try:
        found = np.asarray(given, np.float32)
    except (TypeError, ValueError):
        found = None
    if found is None or found.shape != (choices,):
        raise UserError(
            f"{env_id}: the action_mask of {name} is {_shown(given)}; its {choices} actions need"
            f" an array of shape {(choices,)}"
        )
    if not last and not (found > 0).any():
        raise UserError(
            f"{env_id}: the action_mask of {name} is all zero; at least one of its {choices}"
            " actions must be available until the episode terminates"
        )
    return found


def reward(env_id: str, name: str, given: Any) -> float:
    """A reward. Raises UserError if it is no number."""
    try:
        return float(given)
    except (TypeError, ValueError):
        raise UserError(
            f"{env_id}: the reward of {name} is {_shown(given)}; it must be a number"
        ) from None


def _shown(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}, {value.dtype}"
    return " ".join(reprlib.repr(value).split())
