"""What a distance is: how unlike the newest deployment's transitions a transition is.

Every distance can score all of B_k once a deployment. One that matches each transition with one of
D_k, as the paper's do, can also be computed within the two minibatches of one update (`Matching`),
as Algorithm 1 has it.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

from torch import Tensor

from otc_dist.algorithms.interface import Critic
from otc_dist.description import Description
from otc_dist.otc.data import Data
from otc_dist.otc.samplers.interface import MergedData, Random
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import State
from otc_dist.transitions import RowLayout

Report = Callable[[int, dict[str, float]], None]  # updates done, and their mean metrics
Ids = tuple[Tensor, Tensor]  # row numbers (B,) of the queries and (D,) of the references


class Setting(NamedTuple):
    """What a distance is made for: one agent of a description."""

    description: Description
    layout: RowLayout
    critic: Critic | None  # the algorithm, if it has a Q


class Scores(NamedTuple):
    """How far every transition of B_k is from the newest deployment's."""

    values: Tensor  # (size,), the smaller the more alike
    guarded: float = 0.0  # normalisers that were guarded


class Distance(Protocol):
    """A distance, as the sampler of one agent asks for it.

    Its class has a class method `create(setting: Setting)` that makes it and, where it keeps
    something of every transition, `features(setting: Setting, engine: Engine)` that makes its
    `Features`: they are then `Data.features`, beside the rows.
    """

    def scores(self, held: MergedData, *, exclude_self: bool) -> Scores:
        """Scores of all of B_k, by what D_k holds.

        Args:
            exclude_self: whether transitions of D_k must be judged as if they were not in D_k.
        """
        ...


def scored(distance: Distance, held: MergedData, *, exclude_self: bool) -> Scores:
    """What `distance.scores` gives. Raises ValueError if it is not one score for each row."""
    found = distance.scores(held, exclude_self=exclude_self)
    if found.values.shape != (held.extent.size,):
        shape = tuple(found.values.shape)
        raise ValueError(f"scores has to give {held.extent.size} numbers, not the shape {shape}")
    return found


@runtime_checkable
class Matching(Protocol):
    """A distance that can be computed within one update, from minibatches B and D."""

    def noise_spec(self, candidates: int) -> dict[str, NoiseSpec]:
        """The random arrays that one `between` needs."""
        ...

    def gather(self, data: Data, numbers: Tensor) -> Tensor:
        """What `between` looks at of the rows `numbers`."""
        ...

    def between(
        self, state: State, candidates: Tensor, references: Tensor, ids: Ids | None, noise: Noise
    ) -> tuple[Tensor, Tensor]:
        """d(s', s'*) (B,) of the gathered candidates, and how many normalisers were guarded.

        Args:
            ids: if a transition must not match itself.
        """
        ...

    def similarity(self, held: MergedData) -> tuple[float, float]:
        """Expected transition similarity 𝔻_k (Eq. 4), and how many normalisers were guarded."""
        ...


class Features(Protocol):
    """What a distance keeps of every transition beside its row: fit to B_0, then frozen.

    Attributes:
        name: of the phase that fits them, and of their part of a checkpoint. `fits` of the
            distance's entry in `DISTANCES` says it too, if the fit takes updates.
        size: numbers of a transition.
        updates: that the fit takes; 0: it takes no time.
        state: what was fit; None before.
    """

    name: str
    state: State | None

    @property
    def size(self) -> int: ...

    @property
    def updates(self) -> int: ...

    def fit(self, rows: Tensor, folds: Tensor, random: Random, report: Report) -> None:
        """Fit to packed rows (N, width) of B_0 and freeze.

        Args:
            folds: (N,) 0 or 1, the same for all rows of an episode.
            report: called with the updates done.
        """
        ...

    def embed(self, rows: Tensor, folds: Tensor, out: Tensor) -> None:
        """Write the features of packed rows (N, width) to `out` (N, size); nothing before `fit`."""
        ...
