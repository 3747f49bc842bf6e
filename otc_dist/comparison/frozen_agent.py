"""One agent's frozen policy and embedding, taken from a checkpoint, opened for analysis."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from otc_dist.algorithms import create
from otc_dist.algorithms.interface import Critic, unpack
from otc_dist.comparison.present import packed
from otc_dist.description import Description
from otc_dist.description.distances import DISTANCES
from otc_dist.envs import registry
from otc_dist.learner import checkpoint
from otc_dist.learner.action_scale import ActionScale
from otc_dist.otc.data import Data
from otc_dist.otc.distances import create_features
from otc_dist.otc.distances.interface import Features, Setting
from otc_dist.spec import AgentSpec
from otc_dist.steps.engine import Engine
from otc_dist.steps.noise import Noise, NoiseSpec, sample_noise, to_tensors
from otc_dist.steps.state import State
from otc_dist.transitions import Float32, RowLayout, Transitions

CHUNK = 256  # states acted on at once: 100 candidates each fit into the processor's cache
VALUE_SAMPLES = 10  # actions that V(s') is the mean of, as in the notes on BCQ


class FrozenAgent:
    """What an agent holds at a checkpoint of offline training, as pure functions of its data.

    Raises:
        UserError: the checkpoint is missing or damaged.
    """

    def __init__(self, description: Description, spec: AgentSpec, path: Path) -> None:
        self._spec = spec
        arrays, _ = checkpoint.read(path)
        parts = checkpoint.parts(arrays)
        self.layout = RowLayout(spec.observation_size, spec.action_size, spec.choices)
        self.algorithm = create(description.algorithm, spec, registry.task(description.env.id))
        self.critic = self.algorithm if isinstance(self.algorithm, Critic) else None
        self.engine = Engine("eager")
        self.state: State = to_tensors(parts["algorithm"], self.engine.device)
        self.setting = Setting(description, self.layout, self.critic)
        self._features: dict[str, Features] = {}  # of each distance that keeps some
        for name in DISTANCES:
            if features := create_features(name, self.setting, self.engine):
                features.state = to_tensors(parts[features.name], self.engine.device)
                self._features[name] = features
        self._scale = ActionScale(spec)

    def rows(self, data: Transitions) -> Tensor:
        """Packed rows (N, width); see `present.packed`."""
        return packed(self._spec, data)

    def data(self, rows: Tensor, folds: Tensor) -> dict[str, Data]:
        """Distance -> packed rows (N, width) with what it keeps of them."""
        held = {name: Data(rows, rows[:, :0], folds) for name in DISTANCES}
        for name, features in self._features.items():
            out = torch.empty(len(rows), features.size)
            features.embed(rows, folds, out)
            held[name] = held[name]._replace(features=out)
        return held

    def gap(self, rows: Tensor, random: np.random.Generator) -> Float32:
        """How far the rows' own actions are from what its policy would do now: a - pi(s) (N, a),
        in the environment's units; of discrete actions 1 where they differ, else 0.
        """

        def answer(part: Tensor, noise: Noise) -> Tensor:
            return self.algorithm.act(self.state, unpack(part, self.layout).observation, noise)

        actions = _in_chunks(rows, self.algorithm.acting_noise_spec, random, answer).numpy()
        recorded: Float32 = rows[:, self.layout.action].numpy()
        if self.layout.choices:
            differs: Float32 = (recorded != actions).astype(np.float32)
            return differs
        return self._scale.unscaled(recorded) - self._scale.unscaled(actions)

    def next_values(self, rows: Tensor, random: np.random.Generator) -> Tensor:
        """V(s') (N,), 0 at a terminal s'; not a number if the algorithm has no Q."""
        critic = self.critic
        if critic is None:
            return torch.full((len(rows),), torch.nan)

        def value(part: Tensor, noise: Noise) -> Tensor:
            batch = unpack(part, self.layout)
            values = critic.value(self.state, batch.next_observation, noise)
            return torch.where(batch.terminated > 0, 0.0, values)

        return _in_chunks(
            rows, lambda count: critic.value_noise_spec(count, VALUE_SAMPLES), random, value
        )


def _in_chunks(
    rows: Tensor,
    specs: Callable[[int], Mapping[str, NoiseSpec]],
    random: np.random.Generator,
    function: Callable[[Tensor, Noise], Tensor],
) -> Tensor:
    found = []
    with torch.no_grad():
        for part in torch.split(rows, CHUNK):
            noise = sample_noise(random, specs(len(part)), 1)
            tensors = to_tensors(noise, part.device)
            found.append(function(part, {name: array[0] for name, array in tensors.items()}))
    return torch.cat(found)
