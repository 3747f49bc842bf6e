"""torch, imported when it is first used.

What can be chosen in a description says all of itself in one file, its settings and its arithmetic.
The launcher and the env host read the former only, and torch would take seconds and memory that
they never need. So such a file, and what it imports, has torch from here.
"""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch as torch
else:

    class _Torch(ModuleType):
        def __getattr__(self, name: str) -> object:
            value = getattr(importlib.import_module(self.__name__), name)
            setattr(self, name, value)  # found without this from now on
            return value

    torch = _Torch("torch")
