"""A new algorithm, distance, ... is a file, a line of a registry and a row in docs/: what was
forgotten is told with the place where it belongs.
"""

import pkgutil
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from inspect import getmembers, isclass, isfunction
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks import plain
from otc_dist.description import Description
from otc_dist.description.distances import DISTANCES
from otc_dist.description.kinds import ALGORITHMS, STRATEGIES
from otc_dist.envs import registry
from otc_dist.launch.plan import descriptions
from otc_dist.otc.samplers.correction import ACCEPTANCES
from otc_dist.replay.export.formats import FORMATS
from otc_dist.track.trackers import TRACKERS

ROOT = Path(__file__).parents[1]
EXPORT = "otc_dist.replay.export"


def chosen(module: ModuleType) -> Iterable[str]:
    """Classes that a description can choose."""
    return (name for name, kind in own(module, isclass) if "Section" in vars(kind))


def distances(module: ModuleType) -> Iterable[str]:
    return (
        name
        for name, kind in own(module, isclass)
        if hasattr(kind, "create") and hasattr(kind, "scores")
    )


def functions(wanted: str) -> Callable[[ModuleType], Iterable[str]]:
    return lambda module: (name for name, _ in own(module, isfunction) if name == wanted)


def families(module: ModuleType) -> Iterable[str]:
    return ["FAMILY"] if hasattr(module, "FAMILY") else []


def own(module: ModuleType, wanted: Callable[[object], bool]) -> list[tuple[str, object]]:
    """What the module defines itself."""
    found = getmembers(module, wanted)
    return [(name, one) for name, one in found if one.__module__ == module.__name__]


@dataclass(frozen=True)
class Plug:
    """A kind of thing that the package has several of.

    Attributes:
        package: whose modules, also those of packages in it, have one each.
        finds: names in a module that are such things.
        registered: name -> place, as `module:name`; without names where a list has places alone.
        registry: where a line is missing, for people.
        page: of docs/, which has a row for each name; empty: none.
    """

    package: str
    finds: Callable[[ModuleType], Iterable[str]]
    registered: Mapping[str, str]
    registry: str
    page: str = ""

    def places(self) -> set[str]:
        package = import_module(self.package)
        modules = pkgutil.walk_packages(package.__path__, f"{self.package}.")
        return {
            f"{one.name}:{name}" for one in modules for name in self.finds(import_module(one.name))
        }


PLUGS = {
    "algorithm": Plug(
        "otc_dist.algorithms",
        chosen,
        ALGORITHMS._places,
        "ALGORITHMS in otc_dist/description/kinds.py",
        "method.md",
    ),
    "sampling strategy": Plug(
        "otc_dist.otc.samplers",
        chosen,
        STRATEGIES._places,
        "STRATEGIES in otc_dist/description/kinds.py",
        "method.md",
    ),
    "distance": Plug(
        "otc_dist.otc.distances",
        distances,
        {name: facts.place for name, facts in DISTANCES.items()},
        "DISTANCES in otc_dist/description/distances.py",
        "method.md",
    ),
    "acceptance rule": Plug(
        "otc_dist.otc.acceptance",
        functions("create"),
        {name: rule.place for name, rule in ACCEPTANCES.items()},
        "ACCEPTANCES in otc_dist/otc/samplers/correction.py",
        "method.md",
    ),
    "family of environments": Plug(
        "otc_dist.envs",
        families,
        {
            one: f"{one}:FAMILY"
            for one in (
                f"otc_dist.envs.{name}"
                for name, module in vars(registry).items()
                if getattr(module, "FAMILY", None) in registry._FAMILIES
            )
        },
        "_FAMILIES in otc_dist/envs/registry.py",
    ),
    "export format": Plug(
        EXPORT,
        functions("open_writer"),
        {name: f"{EXPORT}.{one.module}:open_writer" for name, one in FORMATS.items()},
        "FORMATS in otc_dist/replay/export/formats.py",
        "exports.md",
    ),
    "tracker": Plug(
        "otc_dist.track",
        lambda module: (
            name for name in functions("open_tracker")(module) if not hasattr(module, "TRACKERS")
        ),
        {name: f"{kind.module}:open_tracker" for name, kind in TRACKERS.items()},
        "TRACKERS in otc_dist/track/trackers.py",
    ),
}
EACH = pytest.mark.parametrize("kind", PLUGS)


@EACH
def test_what_lies_in_the_folder_is_in_the_registry(kind: str) -> None:
    plug = PLUGS[kind]
    found, registered = plug.places(), set(plug.registered.values())
    assert found
    for place in found - registered:
        pytest.fail(f"no run can choose {place}: it has no line in {plug.registry}")
    for place in registered - found:
        pytest.fail(f"{plug.registry} names {place}, which is no {kind}")


@EACH
def test_what_can_be_chosen_has_a_row_in_the_docs(kind: str) -> None:
    plug = PLUGS[kind]
    if not plug.page:
        return
    text = (ROOT / "docs" / plug.page).read_text()
    for name in plug.registered:
        assert re.search(rf"^\| `{name}`", text, re.M), (
            f"the {kind} {name} has no row in docs/{plug.page}"
        )


def test_every_description_is_in_the_table_of_tasks() -> None:
    text = (ROOT / "docs" / "tasks.md").read_text()
    for name in descriptions.shipped():
        assert re.search(rf"^\|.*`{name}`", text, re.M), f"{name} has no row in docs/tasks.md"


WITHOUT_TORCH = """
import sys
from otc_dist.description.kinds import ALGORITHMS, STRATEGIES
for name, kind in [(name, kind) for kind in (ALGORITHMS, STRATEGIES) for name in kind]:
    kind.section(name)
    if "torch" in sys.modules:
        sys.exit(f"the file of {name}, or what it imports, imports torch: see system/lazy.py")
"""


def test_settings_are_read_without_torch() -> None:
    """By the launcher and the env host, which have no use for it."""
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH], stderr=subprocess.PIPE, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", list(ALGORITHMS))
def test_every_algorithm_has_a_plain_version(name: str) -> None:
    """Which its updates are compared with, and timed beside."""
    assert plain.version(name)


@pytest.mark.parametrize("name", list(DISTANCES))
def test_what_is_said_of_a_distance_is_so(name: str) -> None:
    facts = DISTANCES[name]
    module, _, attribute = facts.place.partition(":")
    kind = getattr(import_module(module), attribute)
    assert facts.per_update == hasattr(kind, "between"), "its `per_update` is whether it matches"
    if facts.fits:
        assert hasattr(kind, "features"), "it has a fit, and no `features` that fits"
        assert facts.fits in Description.model_fields, "its `fits` is no section of a description"
