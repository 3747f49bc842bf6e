"""Base algorithms, one file each, behind one interface."""

from collections.abc import Callable
from typing import Any

from otc_dist.algorithms.awac import Awac
from otc_dist.algorithms.bcq import Bcq
from otc_dist.algorithms.bremen import Bremen
from otc_dist.algorithms.cql import Cql
from otc_dist.algorithms.discrete_cql import DiscreteCql
from otc_dist.algorithms.interface import Algorithm
from otc_dist.algorithms.td3bc import Td3Bc
from otc_dist.description import AlgorithmSection
from otc_dist.description.algorithms import check_fit
from otc_dist.spec import AgentSpec, Task

_ALGORITHMS: dict[str, Callable[..., Algorithm]] = {
    "bcq": Bcq,
    "awac": Awac,
    "cql": Cql,
    "discrete-cql": DiscreteCql,
    "td3bc": Td3Bc,
}
_PLANNING: dict[str, Callable[..., Algorithm]] = {"bremen": Bremen}  # take the task as well


def create(section: AlgorithmSection, spec: AgentSpec, task: Task | None = None) -> Algorithm:
    """The described algorithm for one agent.

    Raises:
        UserError: it is for the other kind of actions, or plans and knows no `task`.
    """
    check_fit(section, spec, task)
    sizes: dict[str, Any] = {"observation_size": spec.observation_size}
    sizes["action_size"] = spec.choices or spec.action_size
    settings = section.model_dump(exclude={"name", "batch_size"})
    if section.name not in _PLANNING:
        return _ALGORITHMS[section.name](**sizes, **settings)
    return _PLANNING[section.name](task=task, **sizes, **settings)
