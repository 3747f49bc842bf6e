"""d3rlpy's algorithms at the sizes of ours, fed by its own replay buffer as its `fit` does."""

import importlib.util
import logging
from typing import Any

import numpy as np

from otc_dist.description.algorithms import AlgorithmSection
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

EPISODE = 1000  # its buffer keeps episodes
NAMES = {
    "bcq": "BCQ",
    "awac": "AWAC",
    "cql": "CQL",
    "discrete-cql": "DiscreteCQL",
    "td3bc": "TD3PlusBC",
}
# Only what changes the cost; rates and weights do not.
COSTS = {
    "bcq": {"target_candidates": "n_action_samples"},
    "cql": {"action_samples": "n_action_samples"},
}


def missing(name: str) -> str:
    """Why `peer` cannot run algorithm `name`, or nothing."""
    if importlib.util.find_spec("d3rlpy") is None:
        return "not installed: pip install -c constraints.txt -e '.[bench]'"
    return "" if name in NAMES else "has none"


class Peer:
    """One of its algorithms: `update` is one step of its `fit`, `again` leaves out sampling."""

    def __init__(self, section: AlgorithmSection, spec: AgentSpec, data: Transitions) -> None:
        d3rlpy = _quiet()
        encoder = d3rlpy.models.VectorEncoderFactory(list(section.hidden))
        config_type = getattr(d3rlpy.algos, f"{NAMES[section.name]}Config")
        fields = config_type.__dataclass_fields__
        settings: dict[str, Any] = {
            key: encoder for key in fields if key.endswith("encoder_factory")
        }
        for ours, theirs in COSTS.get(section.name, {}).items():
            settings[theirs] = getattr(section, ours)
        self._algorithm = config_type(batch_size=section.batch_size, **settings).create("cpu:0")
        self._buffer = d3rlpy.dataset.create_infinite_replay_buffer(_episodes(d3rlpy, data, spec))
        self._algorithm.build_with_dataset(self._buffer)
        self._batch = self._sample()

    def update(self) -> object:
        return self._algorithm.update(self._sample())

    def again(self) -> object:
        return self._algorithm.update(self._batch)

    def _sample(self) -> Any:
        return self._buffer.sample_transition_batch(self._algorithm.batch_size)


def _quiet() -> Any:
    import structlog

    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    import d3rlpy

    return d3rlpy


def _episodes(d3rlpy: Any, data: Transitions, spec: AgentSpec) -> list[Any]:
    actions = data.actions.astype(np.int32) if spec.choices else data.actions
    parts = [slice(start, start + EPISODE) for start in range(0, len(data), EPISODE)]
    return [
        d3rlpy.dataset.Episode(
            data.observations[part], actions[part], data.rewards[part, None], terminated=True
        )
        for part in parts
    ]
