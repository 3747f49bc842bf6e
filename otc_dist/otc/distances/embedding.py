"""d_e, the paper's: transitions are matched and compared in one learned embedding mu(s, a, s').

The embedding is the encoder of a conditional VAE (otc_dist/otc/embedding.py), trained on B_0 and
frozen.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from otc_dist.algorithms.interface import Batch, action_features, unpack
from otc_dist.description import EmbeddingSection
from otc_dist.otc.distances.gaps import gaps
from otc_dist.otc.distances.interface import Ids, Report, Setting
from otc_dist.otc.distances.nearest import FeatureDistance
from otc_dist.otc.embedding import Embedding, active_dimensions
from otc_dist.otc.samplers.correction import settings_of
from otc_dist.otc.samplers.interface import Random
from otc_dist.steps.engine import Engine
from otc_dist.steps.noise import Noise, sample_noise, to_tensors
from otc_dist.steps.state import State
from otc_dist.steps.training import BLOCK, train
from otc_dist.transitions import RowLayout

CHUNK = 8192  # rows embedded at once: more take memory, not less time
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EmbeddingDistance(FeatureDistance):
    """d_e of one agent, over the embeddings that `Data.features` holds."""

    @classmethod
    def create(cls, setting: Setting) -> "EmbeddingDistance":
        return cls(settings_of(setting.description))

    @classmethod
    def features(cls, setting: Setting, engine: Engine) -> "Embedder":
        """mu of every transition."""
        return Embedder(setting.description.embedding, setting.layout, engine)

    def compare(self, queries: Tensor, references: Tensor, ids: Ids | None = None) -> Tensor:
        return nearest_l1(queries, references, ids)


def nearest_l1(queries: Tensor, references: Tensor, ids: Ids | None = None) -> Tensor:
    """d_e: l1 distance (B,) of each query (B, e) to the nearest reference (D, e).

    The one embedding mu(s, a, s') stands for both e(s, a) and e(s'), as in the paper's
    implementation, so the matching distance is the next-state distance and no index is needed.

    Args:
        queries: mu (B, e).
        references: mu (D, e).
        ids: if a transition must not match itself.
    """
    return gaps(queries, references, ids).amin(1)


class Embedder:
    """The frozen embedding mu(s, a, s') of one agent: see `Features`."""

    name = "embedding"

    def __init__(self, section: EmbeddingSection, layout: RowLayout, engine: Engine) -> None:
        self._section, self._layout, self._engine = section, layout, engine
        settings = section.model_dump(exclude={"updates", "batch_size", "minimum_active"})
        action_size = layout.choices or layout.action_size
        self._embedding = Embedding(layout.observation_size, action_size, **settings)
        self.size, self.updates = section.size, section.updates
        self.state: State | None = None

    def fit(self, rows: Tensor, folds: Tensor, random: Random, report: Report) -> None:
        """Train on B_0 and freeze. Logs a warning if too few dimensions are active; the last report
        has `active_dimensions`.
        """
        embedding, size, updates = self._embedding, self._section.batch_size, self._section.updates
        layout = self._layout
        initial = embedding.initial_state(random("initial"), _batch(rows.cpu(), layout))
        step = self._engine.fuse(
            lambda state, rows, sampled: embedding.update(state, _batch(rows, layout), sampled)
        )

        def update(state: State, sampled: Noise) -> tuple[State, Tensor]:
            return step(state, rows.index_select(0, sampled["batch"]), sampled)

        def sample_block(block: int, count: int) -> Mapping[str, NDArray[np.generic]]:
            minibatches, noise = random("minibatches", block), random("noise", block)
            chosen = minibatches.integers(0, len(rows), (count, size))
            return {"batch": chosen, **sample_noise(noise, embedding.noise_spec(size), count)}

        def on_block(state: State, done: int, metrics: list[float]) -> None:
            named = dict(zip(embedding.metric_names, metrics, strict=True))
            if done == updates:
                self.state = state
                named["active_dimensions"] = self._count_active(rows)
            report(done, named)

        state, device = to_tensors(initial, self._engine.device), self._engine.device
        record = self._engine.record(update)
        train(state, record, sample_block, device, (0, updates), BLOCK, on_block)

    def embed(self, rows: Tensor, folds: Tensor, out: Tensor) -> None:
        """Write mu of packed rows (N, width) to `out` (N, e); nothing before `fit`."""
        if self.state is None:
            return
        with torch.no_grad():
            for first in range(0, len(rows), CHUNK):
                part = slice(first, first + CHUNK)
                out[part] = self._embedding.embed(self.state, _batch(rows[part], self._layout))

    def _count_active(self, rows: Tensor) -> int:
        embeddings = torch.empty(len(rows), self.size, device=rows.device)
        self.embed(rows, torch.empty(0), embeddings)
        active = active_dimensions(embeddings)
        if active < self._section.minimum_active:
            log.warning(
                "only %d of %d dimensions of the embedding are active; try a smaller"
                " embedding.kl_weight",
                active,
                self.size,
            )
        return active


def _batch(rows: Tensor, layout: RowLayout) -> Batch:
    """Transitions of packed rows; a discrete action becomes a one-hot vector."""
    batch = unpack(rows, layout)
    return batch._replace(action=action_features(batch.action, layout.choices))
