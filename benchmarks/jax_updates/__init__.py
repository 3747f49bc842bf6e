"""The algorithms' updates as pure JAX functions: the equations of plain/, which are ours.

Each maps (parameters, targets, optimizers, batch, key) to the first three; networks are lists of
(weight, bias), a batch is (s, a, r, s', terminated).
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax

from otc_dist.description.algorithms import AlgorithmSection
from otc_dist.spec import AgentSpec

from . import awac, bcq, cql, discrete_cql, td3bc
from .parts import Algorithm, fresh

__all__ = ["create", "fresh"]

ALGORITHMS: Mapping[str, Callable[[Any, AgentSpec, jax.Array], Algorithm]] = {
    "bcq": bcq.algorithm,
    "awac": awac.algorithm,
    "td3bc": td3bc.algorithm,
    "cql": cql.algorithm,
    "discrete-cql": discrete_cql.algorithm,
}


def create(section: AlgorithmSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
    return ALGORITHMS[section.name](section, spec, key)
