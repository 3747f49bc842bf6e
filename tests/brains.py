"""Small brains and small data for the tests of the learner and what it is made of."""

from pathlib import Path
from typing import Any

import numpy as np

from otc_dist.description import Description
from otc_dist.description.distances import DISTANCES
from otc_dist.description.kinds import STRATEGIES
from otc_dist.learner.learner import Learner, Progress
from otc_dist.otc.samplers.correction import ACCEPTANCES
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

SPEC = AgentSpec("agent_0", 5, action_low=(-0.1, -1.0), action_high=(0.3, 3.0))
ONLINE = 40  # transitions of a deployment
ARMS = {
    "otc-embedding": ("sampling.distance=embedding", "sampling.acceptance=rank"),
    "otc-value": ("sampling.distance=value", "sampling.acceptance=rank"),
    "otc-change": ("sampling.distance=change", "sampling.acceptance=rank"),
    "dynamics-share": ("sampling.distance=dynamics", "sampling.acceptance=share"),
    "typical-conformal": (
        "sampling.distance=typical",
        "sampling.acceptance=conformal",
        "sampling.level=0.1",
    ),
    "value-share": ("sampling.distance=value", "sampling.acceptance=share"),
    "rlpd": ("sampling.name=uniform", "sampling.online_share=0.5"),
    "uniform": ("sampling.name=uniform",),
    "online-only": ("sampling.name=online-only",),
    "balanced": ("sampling.name=balanced",),
}


def _missing() -> dict[str, tuple[str, ...]]:
    """An arm for everything in a registry of which none of these is made."""
    tried = {"sampling.name=otc"} | {text for arm in ARMS.values() for text in arm}
    registries = (
        ("name", STRATEGIES, ()),
        ("distance", DISTANCES, ("sampling.acceptance=share",)),
        ("acceptance", ACCEPTANCES, ("sampling.distance=typical",)),
    )
    return {
        name: (choice, *rest)
        for key, names, rest in registries
        for name in names
        if (choice := f"sampling.{key}={name}") not in tried
    }


ARMS |= _missing()
SMALL: dict[str, Any] = {
    "name": "small",
    "env": {"id": "hopper-3x1"},
    "dataset": {"name": "hopper-3x1/medium-replay"},
    "algorithm": {"name": "bcq", "hidden": [8, 8], "batch_size": 16, "acting_candidates": 7},
    "embedding": {"hidden": [8], "size": 4, "updates": 10, "batch_size": 32, "minimum_active": 0},
    "dynamics": {"hidden": [8], "updates": 10, "batch_size": 16, "correction_updates": 50},
    "sampling": {"candidates": 32, "references": 24, "similarity_sample": 100},
    "offline": {"updates": 25},
    "deployment": {"count": 2, "transitions": ONLINE, "updates": 6},
    "engine": {"name": "eager"},
}


def describe(*assignments: str) -> Description:
    return Description.build(SMALL, assignments)


def transitions(seed: int, count: int, spec: AgentSpec = SPEC) -> Transitions:
    random = np.random.default_rng(seed)
    s = random.standard_normal((count, spec.observation_size)).astype(np.float32)
    low, high = np.array([spec.action_low, spec.action_high])
    actions = random.uniform(low, high, (count, spec.action_size)).astype(np.float32)
    return Transitions(
        observations=s,
        actions=actions,
        rewards=1 + 0.1 * s[:, 0],
        next_observations=s + 0.1 * actions.mean(1, keepdims=True),
        terminated=random.random(count) < 0.05,
        truncated=np.zeros(count, np.bool_),
    )


def brain(*assignments: str, spec: AgentSpec = SPEC, data: Transitions | None = None) -> Learner:
    return Learner(
        describe(*assignments), spec, transitions(0, 200, spec) if data is None else data
    )


def online(k: int) -> Transitions:
    """D_k."""
    return transitions(100 + k, ONLINE)


def silent(progress: Progress) -> None:
    pass


def unsaved() -> None:
    pass


def pretrained(*assignments: str, **arguments: Any) -> Learner:
    learner = brain(*assignments, **arguments)
    learner.pretrain(silent, unsaved)
    return learner


def finished(learner: Learner, path: Path) -> bytes:
    """The last checkpoint after all that is left to do."""
    learner.pretrain(silent, unsaved)
    for k in (1, 2):
        if learner.tuned < k:
            learner.tune(k, online(k), silent)
    learner.save(path)
    return path.read_bytes()
