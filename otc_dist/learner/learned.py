"""What an agent has learned, and how far it has come: all that its checkpoints keep of it."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import torch

from otc_dist.description import Description
from otc_dist.learner import checkpoint
from otc_dist.learner.fits import Fits
from otc_dist.otc.alpha import Alpha
from otc_dist.steps.noise import to_arrays, to_tensors
from otc_dist.steps.state import State


@dataclass
class Learned:
    """One agent's, from its initial state on.

    Attributes:
        fits: what distances fit to B_0.
        state: the algorithm's, with what the sampler learns.
        begun: what the sampler starts from; `sampler` is what it has kept since, if anything.
        offline_updates: updates made offline.
        tuned: k of the policy pi_k; -1 before pi_0.
        together: the seeds whose offline updates were made at once; empty: its own alone.
    """

    description: Description
    agent: str
    device: torch.device
    fits: Fits
    state: State
    begun: Mapping[str, float]
    sampler: Mapping[str, float] = field(default_factory=dict)
    offline_updates: int = 0
    tuned: int = -1
    together: tuple[int, ...] = ()

    @property
    def alpha(self) -> Alpha:
        """alpha_k and the expected similarity 𝔻_k it was adapted to, where the sampler has them."""
        kept = self.sampler or self.begun
        return Alpha(kept.get("alpha", 1.0), kept.get("similarity", math.nan))

    def digest(self) -> str:
        """16 hexadecimal digits that identify the policy and all that updates it, to the bit."""
        return checkpoint.digest(checkpoint.joined({"algorithm": to_arrays(self.state)}))

    def save(self, path: Path) -> None:
        """Write a checkpoint, atomically. Raises UserError if it cannot be written."""
        states = {"algorithm": self.state, **self.fits.states()}
        arrays = checkpoint.joined({name: to_arrays(state) for name, state in states.items()})
        checkpoint.write(path, arrays, self._metadata())

    def load(self, path: Path) -> Mapping[str, checkpoint.Arrays]:
        """Take over a checkpoint's; returns its parts, since `Fits.load` needs the data as well.

        Raises:
            UserError: missing, damaged, or not this agent's: see `checkpoint.read_own`.
        """
        parts, found = checkpoint.read_own(path, self._metadata())
        self.state = to_tensors(parts["algorithm"], self.device)
        self.offline_updates = found.offline_updates
        self.tuned, self.together = found.tuned, found.together
        if found.tuned > 0:
            self.sampler = {"alpha": found.alpha, "similarity": found.similarity}
        return parts

    def check(self, path: Path) -> None:
        """Whether `load` could take over a checkpoint. Raises UserError as it does."""
        checkpoint.read_own(path, self._metadata())

    def revert(self, path: Path, keys: Collection[str]) -> None:
        """Take up the policy of an earlier checkpoint, and what goes back with it.

        Args:
            keys: of the state, which are then the checkpoint's; everything else stays.

        Raises:
            UserError: as `load`.
        """
        earlier = checkpoint.read_own(path, self._metadata())[0]["algorithm"]
        taken = {name: x for name, x in earlier.items() if name in keys}
        self.state = {**self.state, **to_tensors(taken, self.device)}

    def _metadata(self) -> checkpoint.CheckpointMetadata:
        return checkpoint.CheckpointMetadata(
            agent=self.agent,
            offline_digest=self.description.offline_digest(),
            run_digest=self.description.tuning_digest(),
            offline_updates=self.offline_updates,
            tuned=self.tuned,
            alpha=self.alpha.value,
            similarity=self.alpha.similarity,
            together=self.together,
        )
