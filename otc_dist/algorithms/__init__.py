"""Base algorithms, one file each, behind one interface (interface.py).

`ALGORITHMS` in `otc_dist/description/kinds.py` lists them. critics.py and gaussian.py are parts of
several.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from otc_dist.algorithms.interface import Algorithm, Critic
from otc_dist.description import user_code
from otc_dist.description.algorithms import AlgorithmSection, check_fit
from otc_dist.description.kinds import ALGORITHMS

if TYPE_CHECKING:
    from otc_dist.spec import AgentSpec, Task


def create(section: AlgorithmSection, spec: AgentSpec, task: Task | None = None) -> Algorithm:
    """The described algorithm for one agent.

    Raises:
        UserError: it is for the other kind of actions, plans and knows no `task`, or is code of
            the user's own that is not allowed, cannot be loaded, or lacks what an algorithm has.
    """
    kind = ALGORITHMS.find(section.name)
    check_fit(section, spec, task)
    sizes = (spec.observation_size, spec.choices or spec.action_size)
    algorithm: Algorithm = kind(*sizes, section, *((task,) if section.plans else ()))
    for asked in (Algorithm, Critic) if section.has_q else (Algorithm,):
        user_code.check_offers(algorithm, asked, section.name)
    return algorithm
