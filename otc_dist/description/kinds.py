"""What a description chooses by name: algorithms and sampling strategies.

Each is a class in a file of its own, which says all that there is to say of it: its settings are
its `Section`. A new one is such a file, and a line here. One that is not of this package is named
`module:Class`, and is loaded only where that was allowed (`user_code`): else its settings are read
as they stand, and nothing runs.
"""

from collections.abc import Iterable, Iterator
from functools import cache
from typing import Any, Generic, Literal, TypeVar

from pydantic import ConfigDict, Field
from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError

from otc_dist.description import user_code
from otc_dist.description.algorithms import AlgorithmSection
from otc_dist.description.sampling import ALWAYS, SamplingSection
from otc_dist.description.section import Section
from otc_dist.names import is_code
from otc_dist.terminal.errors import UserError

S = TypeVar("S", bound=Section)


class Kind(Generic[S]):
    """The choices of one kind; the first is chosen where a description names none.

    Args:
        base: what their sections are made from.
        places: name -> `module:Class`.
    """

    def __init__(self, base: type[S], places: dict[str, str]) -> None:
        self._base, self._places = base, places
        # Settings of what is not loaded: any, as they stand.
        self._unread: type[S] = type(
            f"Unread{base.__name__}",
            (base,),
            {"__module__": __name__, "model_config": ConfigDict(extra="allow")},
        )

    def __iter__(self) -> Iterator[str]:
        """The names of those in this package."""
        return iter(self._places)

    def find(self, name: str) -> Any:
        """The class of that name; what it offers is a matter of its kind.

        Raises:
            UserError: it is code that is not allowed, cannot be loaded, or has no such `Section`.
        """
        if name not in self._places:
            return _outside(name, self._base)
        return user_code.named(self._places[name], trusted=True)

    def section(self, name: str) -> type[S]:
        """The section of that name; that of code that is not allowed takes any settings."""
        if is_code(name) and not user_code.allowed(name):
            return self._unread
        section: type[S] = self.find(name).Section
        own = section.model_fields.get("name")
        return section if own is not None and own.default == name else _named(section, name)

    def chosen(self, data: object) -> S:
        """The section that a description holds, from its settings.

        Raises:
            ValidationError, UserError: it names nothing that is known, or has a wrong setting.
        """
        if isinstance(data, self._base):
            return data
        if not isinstance(data, dict):
            raise _mistake("model_type", (), data, {"class_name": self._base.__name__})
        name = self._name(data)
        if not isinstance(name, str) or not (name in self._places or is_code(name)):
            expected = ", ".join(map(repr, self))
            problem = PydanticCustomError("literal_error", "unknown", {"expected": expected})
            raise _mistake(problem, ("name",), name)
        return self._made(self.section(name), {**data, "name": name})

    def keys(self, data: object) -> list[str]:
        """The settings that may stand in a section, by the name in it."""
        return list(self.section(str(self._name(data))).model_fields)

    def kept(self, settings: dict[str, object], name: str) -> dict[str, object]:
        """The settings of a section that is to be another's: without what only the old one had.

        All, if the new one is not known or not loaded: what is wrong shows where they are read.
        """
        old = str(self._name(settings))
        if old == name or not self._loaded(name):
            return settings
        of_old = self.keys(settings) if self._loaded(old) else settings
        lost = set(of_old) - self._having(name)
        return {key: value for key, value in settings.items() if key not in lost}

    def _loaded(self, name: str) -> bool:
        return name in self._places or user_code.allowed(name)

    def _having(self, name: str) -> set[str]:
        """The settings that may stay where that one is chosen in place of another."""
        return set(self.keys({"name": name}))

    def _name(self, data: object) -> object:
        first = next(iter(self))
        return data.get("name", first) if isinstance(data, dict) else first

    def _made(self, section: type[S], data: dict[str, object]) -> S:
        return section.model_validate(data)


class Strategies(Kind[SamplingSection]):
    """Sampling strategies, each of which keeps the settings of the others beside its own."""

    DEFAULT = "uniform"  # no other is shown to do more (docs/results.md)

    def _name(self, data: object) -> object:
        """The name given; without one, the default, or what has all the settings that are given."""
        if not isinstance(data, dict) or "name" in data:
            return super()._name(data)
        return self.with_settings(data)

    def with_settings(self, keys: Iterable[str]) -> str:
        """The first strategy that has all these settings; the default, if none has."""
        wanted, names = set(keys), (self.DEFAULT, *self)
        fitting = (name for name in names if wanted <= set(self.section(name).model_fields))
        return next(fitting, self.DEFAULT)

    def settings(self) -> dict[str, type[SamplingSection]]:
        """Setting -> the section in this package that has it."""
        sections = [self.section(name) for name in self]
        return {key: one for one in reversed(sections) for key in one.model_fields}

    def keys(self, data: object) -> list[str]:
        """Those of all strategies may stand beside its own."""
        return [*super().keys(data), *self.settings()]

    def _having(self, name: str) -> set[str]:
        """All, but online data beside what is chosen: those are for who does not choose them."""
        chooses = "online_share" not in self.section(name).model_fields
        return super()._having(name) - ({"online_share"} if chooses else set())

    def _made(self, section: type[SamplingSection], data: dict[str, object]) -> SamplingSection:
        own, beside = dict(data), {}
        for key, other in self.settings().items():
            if key == "name" or key in section.model_fields:
                continue
            given = {key: own.pop(key)} if key in own else {}
            value = getattr(other.model_validate(given), key)
            if key in ALWAYS or value != other.model_fields[key].get_default():
                beside[key] = value
        if beside.get("online_share"):
            raise ValueError(
                f"sampling.online_share is for 'otc' and 'uniform': {data['name']} chooses its"
                " online data itself"
            )
        return section.model_validate(own).with_others(beside)


ALGORITHMS = Kind(
    AlgorithmSection,
    {
        "td3bc": "otc_dist.algorithms.td3bc:Td3Bc",
        "bcq": "otc_dist.algorithms.bcq:Bcq",
        "awac": "otc_dist.algorithms.awac:Awac",
        "cql": "otc_dist.algorithms.cql:Cql",
        "discrete-cql": "otc_dist.algorithms.discrete_cql:DiscreteCql",
        "bremen": "otc_dist.algorithms.bremen.algorithm:Bremen",
    },
)
STRATEGIES = Strategies(
    SamplingSection,
    {
        "otc": "otc_dist.otc.samplers.correction:Correction",
        "uniform": "otc_dist.otc.samplers.uniform:Uniform",
        "online-only": "otc_dist.otc.samplers.online_only:OnlineOnly",
        "balanced": "otc_dist.otc.samplers.balanced:Balanced",
    },
)


def _mistake(
    problem: Any, place: tuple[str, ...], given: object, context: dict[str, object] | None = None
) -> ValidationError:
    """A mistake at a place within a section, as pydantic reports those that it finds."""
    details = InitErrorDetails(type=problem, loc=place, input=given, ctx=context or {})
    return ValidationError.from_exception_data("section", [details])


def _outside(reference: str, base: type[Section]) -> Any:
    """The class of the user's own that `module:Class` names."""
    found = user_code.named(reference)
    section = getattr(found, "Section", None)
    if not (isinstance(section, type) and issubclass(section, base)):
        raise UserError(f"{reference} has no Section made from {base.__name__}")
    return found


@cache
def _named(section: type[S], reference: str) -> type[S]:
    """The section by another name than it may have: how it was named is how it is found again."""
    made: type[S] = type(
        section.__name__,
        (section,),
        {
            "__annotations__": {"name": Literal[reference]},
            "name": Field(default=reference),
            "__module__": section.__module__,
            "__doc__": section.__doc__,
        },
    )
    return made
