"""One agent's data set file: its own <s, a_i, r, s'> and ends, as safetensors, self-checking.

Tensors, all with T rows:

    observations       (T, observation_size)  float32
    actions            (T, action_size)       float32, of this agent only
    rewards            (T,)                   float32
    next_observations  (T, observation_size)  float32, the true successors
    terminated         (T,)                   bool
    truncated          (T,)                   bool
    episodes           (T,)                   int64, which episode a row belongs to

The safetensors metadata has one key, `otc_dist`, that holds the `Header` as JSON (one key,
because safetensors writes several in no fixed order, and equal data must give equal files).
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from otc_dist.envs import registry
from otc_dist.names import AgentName, DatasetId, EnvironmentId
from otc_dist.spec import Size
from otc_dist.system.records import why
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Transitions, choice_problem

FORMAT_VERSION = 1

_KEY = "otc_dist"
_FLOATS = ("observations", "actions", "rewards", "next_observations")

Tensors = Mapping[str, NDArray[Any]]


class Header(BaseModel):
    """What an agent's file says of itself."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format_version: int
    dataset: DatasetId  # "hopper-3x1/medium"
    env_id: EnvironmentId
    agent: AgentName
    transitions: Annotated[int, Field(strict=True, ge=0, lt=2**40)]
    observation_size: Size
    action_size: Size
    origin: str  # how the data came about, in words
    versions: dict[str, str]  # package -> version that wrote it
    sha256: str = ""  # of this header without this field, then of the tensors by name

    def sealed(self, tensors: Tensors) -> Self:
        """This header with the checksum over itself and `tensors`."""
        digest = hashlib.sha256(self.model_copy(update={"sha256": ""}).model_dump_json().encode())
        for name in sorted(tensors):
            digest.update(np.ascontiguousarray(tensors[name]).data)
        return self.model_copy(update={"sha256": digest.hexdigest()})


def encode(header: Header, data: Transitions, episodes: NDArray[np.int64]) -> bytes:
    """The bytes of an agent's file; equal arguments give equal bytes.

    Raises:
        ValueError: shapes or sizes that contradict the header, or values that are not finite.
    """
    tensors = {
        **{name: np.ascontiguousarray(getattr(data, name), np.float32) for name in _FLOATS},
        "terminated": np.ascontiguousarray(data.terminated, np.bool_),
        "truncated": np.ascontiguousarray(data.truncated, np.bool_),
        "episodes": np.ascontiguousarray(episodes, np.int64),
    }
    if problem := _problem(header, tensors):
        raise ValueError(problem)
    return save(tensors, metadata={_KEY: header.sealed(tensors).model_dump_json()})


def load_agent(path: Path, agent: str) -> Transitions:
    """Read and check the data set of `agent`: all that its learner ever sees of B_0.

    Raises:
        UserError: no such file, damaged, another agent's, of another format version, sizes that
            the environment does not have, values that are not finite, or a discrete action that
            was not available.
    """
    header, tensors = _load(path, agent)
    data = Transitions(
        **{name: tensors[name] for name in _FLOATS},
        terminated=tensors["terminated"],
        truncated=tensors["truncated"],
    )
    spec = registry.team_spec(header.env_id)
    if problem := choice_problem(data, spec.agents[spec.index(agent)].choices):
        raise _damaged(path, problem)
    return data


def read_file(path: Path) -> tuple[Header, Tensors]:
    """An agent's file, of any source, checked; errors as in `load_agent`."""
    return _load(path, _read(path)[0].agent)


def load_tensors(path: Path, agent: str) -> Tensors:
    """All tensors of an agent's file, checked; errors as in `load_agent`."""
    return _load(path, agent)[1]


def _load(path: Path, agent: str) -> tuple[Header, Tensors]:
    header, tensors = _read(path)
    if header.agent != agent:
        raise UserError(
            f"{path} holds the data of {header.agent}, not of {agent}; "
            f"give {agent} its own file, {agent}.safetensors"
        )
    problem = _problem(header, tensors)
    if problem is None and header.sealed(tensors).sha256 != header.sha256:
        problem = "its checksum does not match"
    if problem is None:
        problem = _contradiction(header, path)
    if problem is not None:
        raise _damaged(path, problem)
    return header, tensors


def _read(path: Path) -> tuple[Header, Tensors]:
    if not path.is_file():
        raise UserError(f"no data set file {path}; {_remedy(path)}")
    try:
        with safe_open(path, framework="numpy") as file:
            text = (file.metadata() or {}).get(_KEY)
            if text is None:
                raise UserError(f"{path} is not a data set file of otc_dist; {_remedy(path)}")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        header = Header.model_validate_json(text)
    except ValidationError as error:
        raise _damaged(path, f"its header is not valid: {why(error)}") from None
    except (SafetensorError, OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise _damaged(path, str(error).splitlines()[0] if str(error) else "unreadable") from None
    if header.format_version != FORMAT_VERSION:
        raise UserError(
            f"{path} has format version {header.format_version}, this otc_dist reads "
            f"{FORMAT_VERSION}; {_remedy(path)}"
        )
    return header, tensors


def _problem(header: Header, tensors: Tensors) -> str | None:
    """What contradicts the header or is not finite, in a few words; None if nothing does."""
    rows, width = header.transitions, header.observation_size
    shapes: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {
        "observations": ((rows, width), np.float32),
        "actions": ((rows, header.action_size), np.float32),
        "rewards": ((rows,), np.float32),
        "next_observations": ((rows, width), np.float32),
        "terminated": ((rows,), np.bool_),
        "truncated": ((rows,), np.bool_),
        "episodes": ((rows,), np.int64),
    }
    if set(tensors) != set(shapes):
        return f"it holds {', '.join(sorted(tensors))} instead of {', '.join(sorted(shapes))}"
    for name, (shape, dtype) in shapes.items():
        array = tensors[name]
        if array.shape != shape or array.dtype != dtype:
            return f"{name} is {array.dtype} {array.shape}, not {np.dtype(dtype)} {shape}"
    for name in _FLOATS:
        if not np.isfinite(tensors[name]).all():
            row = int(np.argwhere(~np.isfinite(tensors[name]))[0, 0])
            return f"{name} has a value that is not finite (NaN or infinity) in row {row}"
    return None


def _contradiction(header: Header, path: Path) -> str | None:
    """Where the header contradicts the environment that it names; None where it does not.

    Raises:
        UserError: there is no such environment, or it is code that is not allowed.
    """
    try:
        spec = registry.team_spec(header.env_id)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    if header.agent not in spec.names:
        return f"{header.env_id} has no {header.agent}"
    agent = spec.agents[spec.index(header.agent)]
    found = (header.observation_size, header.action_size)
    if found != (agent.observation_size, agent.action_size):
        return (
            f"observation and action sizes {found}, where {header.agent} of {header.env_id} has "
            f"{(agent.observation_size, agent.action_size)}"
        )
    return None


def _damaged(path: Path, problem: str) -> UserError:
    return UserError(f"{path} is damaged or not a data set file: {problem}; {_remedy(path)}")


def _remedy(path: Path) -> str:
    """What to do; `path` ends in ENV/LEVEL/TRANSITIONS/AGENT.safetensors where `store` wrote it."""
    folder = path.absolute().parent
    *_, family, env_id, level, transitions = ("", "", "", *folder.parts)
    if registry.known(f"{family}/{env_id}"):  # an adapter's
        env_id = f"{family}/{env_id}"
    if registry.known(env_id) and transitions.isdecimal():
        name = f"{env_id}/{level} --transitions {transitions}"
        return (
            f"python -m otc_dist.datasets make {name} repairs it (an imported set: import it again)"
        )
    return "make it with python -m otc_dist.datasets make, or import it"
