"""Behaviour policies: shipped snapshots of PPO training, run in NumPy.

The card of a task (`snapshots/<task>/card.json`) says how its snapshots were trained and what
they score; `behaviour_training` is the command that made them.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable

import numpy as np
from safetensors.numpy import load

from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32

LAYERS = ("layer_0", "layer_1", "layer_2")
OBSERVATION_CLIP = 10.0  # normalised observations are clipped to +- this, as in training


class _Network:
    """A tanh network of the normalised observation.

    Sums run over one input feature at a time and not through BLAS, whose order of summation
    depends on the batch: an output is then a function of its own observation alone, to the bit,
    however many copies act together.

    Args:
        tensors: `observation_mean` (O,), `observation_std` (O,), and for each of `LAYERS` its
            `.weight` (outputs, inputs) and `.bias` (outputs,).
    """

    def __init__(self, tensors: Mapping[str, Float32]) -> None:
        self._mean = tensors["observation_mean"][:, None]
        self._scale = (1.0 / tensors["observation_std"])[:, None]
        # Columns first: one contiguous column a feature.
        self._columns = [np.ascontiguousarray(tensors[f"{x}.weight"].T) for x in LAYERS]
        self._biases = [tensors[f"{x}.bias"][:, None] for x in LAYERS]

    def __call__(self, observations: Float32) -> Float32:
        """Outputs (outputs, E) for observations (E, O)."""
        hidden = (observations.T - self._mean) * self._scale
        np.clip(hidden, -OBSERVATION_CLIP, OBSERVATION_CLIP, out=hidden)
        last = len(LAYERS) - 1
        for index, (columns, bias) in enumerate(zip(self._columns, self._biases, strict=True)):
            hidden = _linear(columns, bias, hidden)
            if index < last:
                np.tanh(hidden, out=hidden)
        return hidden


class GaussianPolicy:
    """Continuous actions: a = clip(mean(s) + exp(log_std) * noise, -1, 1).

    Args:
        tensors: the network's, and `log_std` (A,).
    """

    def __init__(self, tensors: Mapping[str, Float32]) -> None:
        self._network = _Network(tensors)
        self._std: Float32 = np.exp(tensors["log_std"])

    def noise(self, random: np.random.Generator, count: int) -> Float32:
        """Standard normal noise for `count` actions, (count, A)."""
        return random.standard_normal((count, len(self._std)), np.float32)

    def act(self, observations: Float32, noise: Float32) -> Float32:
        """Actions (E, A) for observations (E, O) and noise (E, A)."""
        actions = self._network(observations).T + self._std * noise
        return np.clip(actions, -1.0, 1.0, out=actions)


class MaskedPolicy:
    """Discrete actions: a = argmax over the available ones of logit(s) + noise, a softmax sample.

    Args:
        tensors: the network's; its outputs are the logits.
    """

    def __init__(self, tensors: Mapping[str, Float32]) -> None:
        self._network = _Network(tensors)
        self._choices = len(tensors[f"{LAYERS[-1]}.bias"])

    def noise(self, random: np.random.Generator, count: int) -> Float32:
        """Standard Gumbel noise for `count` actions, (count, choices)."""
        return random.gumbel(size=(count, self._choices)).astype(np.float32)

    def act(self, observations: Float32, noise: Float32) -> Float32:
        """Indices (E, 1) for observations (E, O), whose tail is the mask, and noise."""
        available = observations[:, -self._choices :] > 0
        scores = np.where(available, self._network(observations).T + noise, -np.inf)
        best: Float32 = scores.argmax(axis=1).astype(np.float32)
        return best[:, None]


BehaviourPolicy = GaussianPolicy | MaskedPolicy


def policy_of(tensors: Mapping[str, Float32]) -> BehaviourPolicy:
    """The policy that a snapshot's tensors are of."""
    return GaussianPolicy(tensors) if "log_std" in tensors else MaskedPolicy(tensors)


def _linear(columns: Float32, bias: Float32, inputs: Float32) -> Float32:
    """W x + b for inputs (K, E), with `columns` = W^T (K, H), bias (H, 1): (H, E)."""
    shape = (columns.shape[1], inputs.shape[1])
    total = np.empty(shape, np.float32)
    total[...] = bias
    product = np.empty(shape, np.float32)
    for column, feature in zip(columns, inputs, strict=True):
        np.multiply(column[:, None], feature, out=product)
        np.add(total, product, out=total)
    return total


@dataclass(frozen=True)
class Snapshot:
    """One row of a card: a policy on the way of training, and its true stochastic returns."""

    file: str  # "step_XXXXXX.safetensors"
    steps: int  # environment steps trained
    return_mean: float
    return_std: float
    episodes: int  # that the mean and the standard deviation are over
    sha256: str
    success: float | None = None  # percent of these episodes won, where the task has such a thing


@dataclass(frozen=True)
class Card:
    """The snapshots of one task in training order, up to the medium one, which is the last."""

    snapshots: tuple[Snapshot, ...]

    @property
    def medium(self) -> Snapshot:
        """Where training stopped: a robot's about the mean return of D4RL's medium data."""
        return self.snapshots[-1]


def snapshot_folder(task: str) -> Traversable:
    """Where the package keeps the snapshots of `task`: a robot's or a skirmish's name."""
    return resources.files("otc_dist.datasets").joinpath("snapshots", task)


def load_card(task: str) -> Card:
    """Read the card of `task`. Raises UserError if the package has no snapshots of it."""
    path = snapshot_folder(task).joinpath("card.json")
    if not path.is_file():
        raise UserError(
            f"no behaviour policies of {task!r}; "
            f"make them: python -m otc_dist.datasets.behaviour_training {task}"
        )
    card = json.loads(path.read_text(encoding="utf-8"))
    return Card(tuple(Snapshot(**row) for row in card["snapshots"]))


def load_policy(task: str, snapshot: Snapshot) -> BehaviourPolicy:
    """Load one snapshot of `task`."""
    return policy_of(load(snapshot_folder(task).joinpath(snapshot.file).read_bytes()))
