"""Here environments of the user's own are named by the tests themselves, and so may be run."""

import itertools
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from otc_dist.description import user_code


@pytest.fixture(autouse=True)
def our_own_code(monkeypatch: pytest.MonkeyPatch) -> None:
    found = user_code.found

    def allowed(reference: str) -> Callable[[], object]:
        user_code.allow(reference)
        return found(reference)

    monkeypatch.setattr(user_code, "found", allowed)


_NUMBERS = itertools.count()


@pytest.fixture
def name_of(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], Any]], str]:
    """The id of an environment that a function makes, in a module of its own."""

    def put(make: Callable[[], Any]) -> str:
        module = ModuleType(f"admission_case_{next(_NUMBERS)}")
        module.parallel_env, module.__file__ = make, __file__  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, module.__name__, module)
        return f"{module.__name__}:parallel_env"

    return put
