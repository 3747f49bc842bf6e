"""The algorithms as they are usually written in torch: what ours must equal, and the peers that it
is timed against.

Modules, autograd, torch.optim.Adam, one operation after another, as in single-file
implementations such as CORL's, written from the published equations. Sizes and rates come from
the same sections as ours; nothing else here is shared with the library. The tests make hundred
updates in float64 with noise of their own (tests/algorithms), the benchmarks let each update draw
its own minibatch and noise (`parts.Training`).

States are standardised beforehand where an algorithm wants that (`standardised`).
"""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from otc_dist.description.kinds import ALGORITHMS
from otc_dist.terminal.errors import UserError


def version(name: str) -> Any:
    """The plain version of algorithm `name`: the class of its class's name in the file of its name.

    Raises:
        UserError: there is none yet.
    """
    file, kind = name.replace("-", "_"), f"Plain{ALGORITHMS.find(name).__name__}"
    found = import_module(f".{file}", __name__) if find_spec(f".{file}", __name__) else None
    if not hasattr(found, kind):
        raise UserError(f"{name} has no plain version: write {kind} in benchmarks/plain/{file}.py")
    return getattr(found, kind)
