"""Names: of agents, runs, data sets, descriptions and environments.

A name becomes a file's name, a part of a bus key and a word on a page, and it may come from
somebody else's file. So there is one form for all of them, checked wherever one enters; no code
after that has to ask whether `../x` is among them.
"""

import re
from collections.abc import Iterable
from typing import Annotated

from pydantic import AfterValidator

LONGEST = 128  # characters of a name; a file's name has room for as many and an ending
# Names that stand for something else where an agent's name stands: a process, a key of the bus, a
# folder of certificates, a data set of all agents, what is done before and after a run.
_PROCESSES = ("host", "joint", "launcher", "local", "observer", "router")
RESERVED = frozenset((*_PROCESSES, "alive", "authority", "compile", "data", "report"))

_NAME = re.compile(rf"[A-Za-z0-9_][A-Za-z0-9._-]{{0,{LONGEST - 1}}}")
_MODULE = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
_FORM = f"letters, digits, _, . and -, at most {LONGEST}, and none of the last two in front"


def is_name(text: str) -> bool:
    """Whether `text` has the form of every name."""
    return _NAME.fullmatch(text) is not None


def is_code(text: str) -> bool:
    """Whether `text` has the form `module:function`."""
    return len(text) <= LONGEST and _MODULE.fullmatch(text) is not None


def checked(text: str) -> str:
    """`text`, if it has the form of a name. Raises ValueError."""
    if not is_name(text):
        raise ValueError(f"{_shown(text)} is not a valid name: a name is of {_FORM}")
    return text


def checked_agent(text: str) -> str:
    """`text`, if an agent can be called so. Raises ValueError."""
    if checked(text).lower() in RESERVED:
        raise ValueError(f"an agent cannot be called {text!r}: that stands for something else")
    return text


def checked_environment(text: str) -> str:
    """`text`, if an environment's id: `name`, `family/name` or `module:function`, else ValueError.

    Whether there is such an environment is another question.
    """
    if not (is_code(text) or (text.count("/") <= 1 and all(map(is_name, text.split("/"))))):
        raise ValueError(
            f"{_shown(text)} is not a valid environment id: name, family/name or module:function,"
            f" where a name is of {_FORM}"
        )
    return text


def checked_dataset(text: str) -> str:
    """`text`, if a data set's id: `environment/name`, else ValueError."""
    env_id, slash, name = text.rpartition("/")
    if slash:
        checked_environment(env_id)
    checked(name)
    return text


def check_agents(names: Iterable[str]) -> None:
    """Refuse agents one of which has no name of the right form, or that of another.

    Raises:
        ValueError: the first name that will not do.
    """
    seen: set[str] = set()
    for name in names:
        if checked_agent(name).lower() in seen:
            raise ValueError(f"two agents are called {name!r}")
        seen.add(name.lower())


def from_text(text: str) -> str:
    """A name made of any text: what cannot stand in one becomes `_`, and what is too long goes."""
    name = re.sub(r"[^A-Za-z0-9._-]", "_", text)[:LONGEST]
    return name if is_name(name) else f"_{name}"[:LONGEST]


def _shown(text: str) -> str:
    """A text of unknown length and content, for a message."""
    return repr(text) if len(text) <= LONGEST else f"{text[:LONGEST]!r}..."


Name = Annotated[str, AfterValidator(checked)]
AgentName = Annotated[str, AfterValidator(checked_agent)]
DatasetId = Annotated[str, AfterValidator(checked_dataset)]
EnvironmentId = Annotated[str, AfterValidator(checked_environment)]
