"""An agent's brain: pretrain, act, tune, checkpoint (Algorithm 1). It knows no bus and no
environment.

    learner = Learner(description, spec, data)
    learner.pretrain(report, save)                                  # pi_0
    for k in 1..K:
        actions = learner.act(observations, "deployment", k, step)  # by pi_{k-1}, M / E times
        learner.tune(k, own_transitions, report)                    # pi_k

Everything random is keyed by (seed, agent, purpose, deployment, step or block of updates).
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from otc_dist import checkpoint
from otc_dist.algorithms import create
from otc_dist.algorithms.draws import Draws, draw, to_tensors
from otc_dist.algorithms.interface import State, unpack
from otc_dist.description import Description
from otc_dist.embedder import Embedder
from otc_dist.engine import Engine, Update, resolve
from otc_dist.errors import UserError
from otc_dist.otc import create_sampler
from otc_dist.otc.alpha import Alpha
from otc_dist.otc.samplers import Data, Extent, Sampler, Uniform
from otc_dist.otc.similarity import embedding_similarity, value_similarity
from otc_dist.randomness import stream
from otc_dist.spec import AgentSpec
from otc_dist.training import train
from otc_dist.transitions import Float32, ReplayBuffer, RowLayout, Transitions

SAVE_EVERY = 10_000  # offline updates between two checkpoints
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Progress:
    """Where training stands. Reported every 100 updates, the same in every run of a seed."""

    phase: Literal["offline", "embedding", "tuning"]
    deployment: int  # 0 while offline
    update: int
    updates: int
    metrics: dict[str, float]  # means since the last report; tuning's first: alpha, similarity


Report = Callable[[Progress], None]


class Learner:
    """One agent: its data, its replay buffer, its sampler and its policy, and nobody else's.

    Attributes:
        tuned: k of the policy pi_k it holds; -1 before pi_0.

    Raises:
        UserError: the engine cannot run here.
        ValueError: data of other sizes than the agent's, or that are not finite.
    """

    def __init__(self, description: Description, spec: AgentSpec, data: Transitions) -> None:
        self.description, self.spec = description, spec
        self.tuned = -1
        self._agent = spec.name
        self._offline_updates = 0
        self._alpha = Alpha(description.sampling.alpha)
        deployments = description.deployment
        updates = description.offline.updates + deployments.count * deployments.updates
        self._engine = Engine(resolve(description.engine.name, updates))

        low, high = np.array([spec.action_low, spec.action_high], np.float32)
        self._action_low, self._action_high = low, high
        self._action_centre: Float32 = (low + high) / np.float32(2)
        self._action_scale: Float32 = (high - low) / np.float32(2)
        self._layout = RowLayout(spec.observation_size, spec.action_size)
        online = deployments.count * deployments.transitions
        self._buffer = ReplayBuffer(self._layout, len(data) + online)

        algorithm, sampling = description.algorithm, description.sampling
        self._algorithm = create(algorithm, spec.observation_size, spec.action_size)
        self._uniform = Uniform(algorithm.batch_size)
        self._sampler = create_sampler(
            sampling, self._algorithm, self._layout, algorithm.batch_size
        )
        self._embedder: Embedder | None = None
        if sampling.name == "otc" and sampling.distance == "embedding":
            self._embedder = Embedder(description.embedding, self._layout, self._engine)

        capacity, device = len(self._buffer.rows), self._engine.device
        width = description.embedding.size if self._embedder else 0
        self._data = Data(
            torch.from_numpy(self._buffer.rows).to(device), torch.zeros(capacity, width).to(device)
        )
        self._append(data, offline=True)
        initial = self._algorithm.initial_state(self._stream("initial"))
        self._state: State = to_tensors(initial, device)
        self._step = self._engine.fuse(
            lambda state, rows, draws: self._algorithm.update(
                state, unpack(rows, self._layout), draws
            )
        )

    @property
    def alpha(self) -> Alpha:
        """alpha_k and the expected similarity 𝔻_k it was adapted to."""
        return self._alpha

    def pretrain(self, report: Report, save: Callable[[], None]) -> None:
        """Train pi_0 on B_0, and the embedding if the sampler needs one: whatever is left to do.

        Args:
            save: called every SAVE_EVERY updates, to keep an unfinished state.
        """
        updates, names = self.description.offline.updates, self._algorithm.metric_names

        def on_block(state: State, done: int, metrics: list[float]) -> None:
            self._state, self._offline_updates = state, done
            report(Progress("offline", 0, done, updates, dict(zip(names, metrics, strict=False))))
            if done % SAVE_EVERY == 0 and done < updates:
                save()

        update = self._engine.record(self._update_by(self._uniform))
        draw_block = self._draw_by(self._uniform, 0, "offline")
        span = (self._offline_updates, updates)
        train(self._state, update, draw_block, self._engine.device, span, on_block)
        if self._embedder and self._embedder.state is None:
            total = self.description.embedding.updates
            self._embedder.train(
                self._data.rows[: self._buffer.offline_size],
                lambda *key: self._stream("embedding", *key),
                lambda done, metrics: report(Progress("embedding", 0, done, total, metrics)),
            )
            self._embed(0, self._buffer.size)
        self.tuned = max(self.tuned, 0)

    def act(
        self,
        observations: Float32,
        phase: Literal["deployment", "evaluation"],
        deployment: int,
        step: int,
    ) -> Float32:
        """Actions (E, action_size) of the policy it holds, for observations (E, s).

        A pure function of the policy and the arguments, so that answering twice is harmless.
        """
        wanted = self._algorithm.acting_noise(len(observations))
        noise = draw(self._stream("act", phase, deployment, step), wanted, 1)
        device = self._engine.device
        with torch.no_grad():
            draws = {name: array[0] for name, array in to_tensors(noise, device).items()}
            states = torch.tensor(observations, device=device)
            actions = self._algorithm.act(self._state, states, draws).cpu().numpy()
        actions = actions * self._action_scale + self._action_centre
        # Rounding may exceed bounds by a bit.
        clipped: Float32 = np.clip(actions, self._action_low, self._action_high)
        return clipped

    def tune(self, deployment: int, data: Transitions, report: Report) -> None:
        """Merge D_k, adapt alpha by Eq. 4, and make L updates (lines 5 to 16 of Algorithm 1).

        Optimizers and targets are kept from before. Afterwards `tuned == deployment`.

        Raises:
            ValueError: not the deployment after `tuned`, or data that are not finite.
        """
        if deployment != self.tuned + 1:
            raise ValueError(f"cannot tune on deployment {deployment} after {self.tuned}")
        self._append(data, offline=False)
        updates = self.description.deployment.updates
        measured = self._adapt(deployment) if self.description.sampling.name == "otc" else {}
        report(Progress("tuning", deployment, 0, updates, measured))
        names = (*self._algorithm.metric_names, "guarded")

        def on_block(state: State, done: int, metrics: list[float]) -> None:
            named = dict(zip(names, metrics, strict=True))
            report(Progress("tuning", deployment, done, updates, named))

        update = self._engine.record(self._update_by(self._sampler))
        draw_block = self._draw_by(self._sampler, deployment, "tuning")
        self._state = train(
            self._state, update, draw_block, self._engine.device, (0, updates), on_block
        )
        self.tuned = deployment

    def policy_digest(self) -> str:
        """16 hexadecimal digits that identify the policy and all that updates it, to the bit."""
        return checkpoint.digest(self._arrays("algorithm", self._state))

    def save(self, path: Path) -> None:
        """Write a checkpoint, atomically. Raises UserError if it cannot be written."""
        arrays = self._arrays("algorithm", self._state)
        if self._embedder and self._embedder.state is not None:
            arrays |= self._arrays("embedding", self._embedder.state)
        checkpoint.write(path, arrays, self._progressed())

    def load(self, path: Path) -> None:
        """Take over a checkpoint's state; `restore` then merges D_1 .. D_tuned again.

        A checkpoint of offline training fits every description that differs only in how it
        tunes. If it lacks the embedding that this one needs, `pretrain` trains it.

        Raises:
            UserError: missing, damaged, another agent's or of another description.
        """
        arrays, found = checkpoint.read(path)
        mine = self._progressed()
        if found.agent != mine.agent:
            raise UserError(f"the checkpoint {path} is {found.agent}'s, not {mine.agent}'s")
        same_run = found.tuned <= 0 or found.run_digest == mine.run_digest
        if found.offline_digest != mine.offline_digest or not same_run:
            raise UserError(f"the checkpoint {path} was made by another description; use its own")
        states: dict[str, dict[str, NDArray[np.generic]]] = {"algorithm": {}, "embedding": {}}
        for name, array in arrays.items():
            part, _, key = name.partition(".")
            states[part][key] = array
        self._state = to_tensors(states["algorithm"], self._engine.device)
        self._offline_updates = found.offline_updates
        self.tuned = found.tuned
        if self._embedder:
            if states["embedding"]:
                self._embedder.state = to_tensors(states["embedding"], self._engine.device)
                self._embed(0, self._buffer.size)
            else:
                self.tuned = -1
        if found.tuned > 0:
            self._alpha = Alpha(found.alpha, found.similarity)

    def restore(self, online: Sequence[Transitions]) -> None:
        """After `load`: merge D_1 .. D_tuned again, in order."""
        for data in online:
            self._append(data, offline=False)

    def _stream(self, *key: int | str) -> np.random.Generator:
        return stream(self.description.seed, self._agent, *key)

    def _extent(self) -> Extent:
        buffer = self._buffer
        return Extent(buffer.offline_size, buffer.newest_start, buffer.size)

    def _append(self, data: Transitions, *, offline: bool) -> None:
        """Merge transitions, with actions scaled to [-1, 1], and embed them if d_e is ready."""
        start = self._buffer.size
        self._buffer.append(data, offline=offline)
        end = self._buffer.size
        actions = self._buffer.rows[start:end, self._layout.action]
        actions[:] = (actions - self._action_centre) / self._action_scale
        if self._engine.device.type != "cpu":  # on the CPU both are the same memory
            self._data.rows[start:end] = torch.from_numpy(self._buffer.rows[start:end])
        self._embed(start, end)

    def _embed(self, start: int, end: int) -> None:
        if self._embedder:
            self._embedder.embed(self._data.rows[start:end], self._data.embeddings[start:end])

    def _adapt(self, deployment: int) -> dict[str, float]:
        sampling = self.description.sampling
        random = self._stream("similarity", deployment)
        data, extent = self._data, self._extent()
        guarded = 0.0
        with torch.no_grad():
            if sampling.distance == "embedding":
                similarity = embedding_similarity(data, extent, sampling, random)
            else:
                similarity, guarded = value_similarity(
                    self._algorithm, self._state, data, extent, self._layout, sampling, random
                )
        if sampling.adaptive:
            self._alpha = self._alpha.adapt(similarity, sampling.alpha_bound)
            if self._alpha.value == sampling.alpha_bound > 0:
                log.warning("sampling.alpha_bound binds: alpha is %g", self._alpha.value)
        return {"alpha": self._alpha.value, "similarity": similarity, "guarded": guarded}

    def _update_by(self, sampler: Sampler) -> Update:
        """One update on rows that `sampler` chooses; the choice's `guarded` joins the metrics."""
        select = self._engine.fuse(sampler.select) if sampler.noise() else sampler.select

        def update(state: State, draws: Draws) -> tuple[State, torch.Tensor]:
            selection = select(state, sampler.gather(self._data, draws), draws)
            rows = self._data.rows.index_select(0, selection.rows)
            state, metrics = self._step(state, rows, draws)
            return state, torch.cat((metrics, selection.guarded.view(1)))

        return update

    def _draw_by(
        self, sampler: Sampler, deployment: int, purpose: str
    ) -> Callable[[int, int], Mapping[str, NDArray[np.generic]]]:
        wanted = {
            **self._algorithm.noise(self.description.algorithm.batch_size),
            **sampler.noise(),
        }
        extent = self._extent()
        # Offline training is common to all minibatch keys.
        key = self.description.minibatch_key if deployment else 0
        alpha = np.float32(self._alpha.value)

        def draw_block(block: int, count: int) -> Mapping[str, NDArray[np.generic]]:
            minibatches = self._stream(f"{purpose}-minibatches", key, deployment, block)
            noise = self._stream(f"{purpose}-noise", deployment, block)
            indices = sampler.draw(minibatches, count, extent)
            return {"alpha": np.full(count, alpha), **indices, **draw(noise, wanted, count)}

        return draw_block

    def _progressed(self) -> checkpoint.Progressed:
        return checkpoint.Progressed(
            agent=self._agent,
            offline_digest=self.description.offline_digest(),
            run_digest=self.description.digest(),
            offline_updates=self._offline_updates,
            tuned=self.tuned,
            alpha=self._alpha.value,
            similarity=self._alpha.similarity,
        )

    @staticmethod
    def _arrays(part: str, state: State) -> dict[str, NDArray[np.generic]]:
        return {f"{part}.{name}": tensor.cpu().numpy() for name, tensor in state.items()}
