"""Training of the embedding of d_e on B_0, and mu of every transition a learner holds."""

import logging
from collections.abc import Callable, Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from otc_dist.algorithms.draws import Draws, draw, to_tensors
from otc_dist.algorithms.interface import Batch, State, action_features, unpack
from otc_dist.description import EmbeddingSection
from otc_dist.engine import Engine
from otc_dist.otc.embedding import Embedding, active_dimensions
from otc_dist.training import BLOCK, train
from otc_dist.transitions import RowLayout

CHUNK = 8192  # rows embedded at once: more take memory, not less time
log = logging.getLogger(__name__)


class Embedder:
    """The frozen embedding mu(s, a, s') of one agent: `state` is None until it is trained.

    Attributes:
        size: of mu, e.
    """

    def __init__(self, section: EmbeddingSection, layout: RowLayout, engine: Engine) -> None:
        self._section, self._layout, self._engine = section, layout, engine
        settings = section.model_dump(exclude={"updates", "batch_size", "minimum_active"})
        action_size = layout.choices or layout.action_size
        self._embedding = Embedding(layout.observation_size, action_size, **settings)
        self.size = section.size
        self.state: State | None = None

    def train(
        self,
        rows: Tensor,
        random: Callable[..., np.random.Generator],
        report: Callable[[int, dict[str, float]], None],
    ) -> None:
        """Train on B_0 and freeze. Logs a warning if too few dimensions are active.

        Args:
            rows: packed rows (N, width) of B_0.
            random: a stream for a key, as `Learner` keys them.
            report: called with the updates done and their metrics, at the end with
                `active_dimensions`.
        """
        embedding, size, updates = self._embedding, self._section.batch_size, self._section.updates
        layout = self._layout
        initial = embedding.initial_state(random("initial"), _batch(rows.cpu(), layout))
        step = self._engine.fuse(
            lambda state, rows, draws: embedding.update(state, _batch(rows, layout), draws)
        )

        def update(state: State, draws: Draws) -> tuple[State, Tensor]:
            return step(state, rows.index_select(0, draws["batch"]), draws)

        def draw_block(block: int, count: int) -> Mapping[str, NDArray[np.generic]]:
            minibatches, noise = random("minibatches", block), random("noise", block)
            chosen = minibatches.integers(0, len(rows), (count, size))
            return {"batch": chosen, **draw(noise, embedding.noise(size), count)}

        def on_block(state: State, done: int, metrics: list[float]) -> None:
            named = dict(zip(embedding.metric_names, metrics, strict=True))
            if done == updates:
                self.state = state
                named["active_dimensions"] = self._count_active(rows)
            report(done, named)

        state, device = to_tensors(initial, self._engine.device), self._engine.device
        record = self._engine.record(update)
        train(state, record, draw_block, device, (0, updates), BLOCK, on_block)

    def embed(self, rows: Tensor, out: Tensor) -> None:
        """Write mu of packed rows (N, width) into `out` (N, e); does nothing before `train`."""
        if self.state is None:
            return
        with torch.no_grad():
            for first in range(0, len(rows), CHUNK):
                part = slice(first, first + CHUNK)
                out[part] = self._embedding.embed(self.state, _batch(rows[part], self._layout))

    def _count_active(self, rows: Tensor) -> int:
        embeddings = torch.empty(len(rows), self.size, device=rows.device)
        self.embed(rows, embeddings)
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
    """Transitions of packed rows; a discrete action is told as a one-hot vector."""
    batch = unpack(rows, layout)
    return batch._replace(action=action_features(batch.action, layout.choices))
