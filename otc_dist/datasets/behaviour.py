"""Behaviour policies: shipped snapshots of PPO training, run in NumPy.

The card of a robot (`snapshots/<robot>/card.json`) says how its snapshots were trained and what
they score; `behaviour_training.py` is the script that made them.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable

import numpy as np
from safetensors.numpy import load

from otc_dist.errors import UserError
from otc_dist.transitions import Float32

LAYERS = ("layer_0", "layer_1", "layer_2")
OBSERVATION_CLIP = 10.0  # normalised observations are clipped to +- this, as in training


class BehaviourPolicy:
    """A Gaussian policy: tanh network of the normalised observation, state-independent std.

    a = clip(mean(s) + exp(log_std) * noise, -1, 1)

    Sums run over one input feature at a time and not through BLAS, whose order of summation
    depends on the batch: an action is then a function of its own observation and noise alone,
    to the bit, however many copies act together.

    Args:
        tensors: `observation_mean` (O,), `observation_std` (O,), `log_std` (A,), and for each of
            `LAYERS` its `.weight` (outputs, inputs) and `.bias` (outputs,).
    """

    def __init__(self, tensors: Mapping[str, Float32]) -> None:
        self._mean = tensors["observation_mean"][:, None]
        self._scale = (1.0 / tensors["observation_std"])[:, None]
        self._std = np.exp(tensors["log_std"])
        # Columns first: one contiguous column a feature.
        self._columns = [np.ascontiguousarray(tensors[f"{x}.weight"].T) for x in LAYERS]
        self._biases = [tensors[f"{x}.bias"][:, None] for x in LAYERS]

    def act(self, observations: Float32, noise: Float32) -> Float32:
        """Actions (E, A) for observations (E, O) and standard normal noise (E, A)."""
        hidden = (observations.T - self._mean) * self._scale
        np.clip(hidden, -OBSERVATION_CLIP, OBSERVATION_CLIP, out=hidden)
        last = len(LAYERS) - 1
        for index, (columns, bias) in enumerate(zip(self._columns, self._biases, strict=True)):
            hidden = _linear(columns, bias, hidden)
            if index < last:
                np.tanh(hidden, out=hidden)
        actions = hidden.T + self._std * noise
        return np.clip(actions, -1.0, 1.0, out=actions)


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


@dataclass(frozen=True)
class Card:
    """The snapshots of one robot in training order, up to the medium one, which is the last."""

    robot: str
    snapshots: tuple[Snapshot, ...]

    @property
    def medium(self) -> Snapshot:
        """Where training stopped: about the mean return of D4RL's medium data."""
        return self.snapshots[-1]


def snapshot_folder(robot: str) -> Traversable:
    """Where the package keeps the snapshots of `robot`."""
    return resources.files("otc_dist.datasets").joinpath("snapshots", robot)


def load_card(robot: str) -> Card:
    """Read the card of `robot`. Raises UserError if the package has no snapshots of it."""
    path = snapshot_folder(robot).joinpath("card.json")
    if not path.is_file():
        raise UserError(
            f"no behaviour policies of {robot!r}; "
            f"make them: python -m otc_dist.datasets.behaviour_training {robot}"
        )
    card = json.loads(path.read_text(encoding="utf-8"))
    return Card(card["robot"], tuple(Snapshot(**row) for row in card["snapshots"]))


def load_policy(robot: str, snapshot: Snapshot) -> BehaviourPolicy:
    """Load one snapshot of `robot`."""
    return BehaviourPolicy(load(snapshot_folder(robot).joinpath(snapshot.file).read_bytes()))
