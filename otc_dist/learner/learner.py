"""An agent's brain: pretrain, act, tune, checkpoint (Algorithm 1). It knows no bus and no
environment.

    learner = Learner(description, spec, data)
    learner.pretrain(report, save)                                  # pi_0
    for k in 1..K:
        actions = learner.act(observations, "deployment", k, step)  # by pi_{k-1}, M / E times
        learner.tune(k, own_transitions, report)                    # pi_k

Everything random is keyed by (seed, agent, purpose, deployment, step or block of updates).
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

from otc_dist.algorithms import create
from otc_dist.algorithms.interface import Algorithm, Critic, unpack
from otc_dist.description import Description
from otc_dist.learner import checkpoint
from otc_dist.learner.actor import ActingPhase, Actor
from otc_dist.learner.experience import Experience
from otc_dist.learner.fits import Fits
from otc_dist.learner.trainer import (
    Phase,
    Progress,
    Report,
    Trainer,
    Work,
    fused_update,
    improvements,
)
from otc_dist.otc import create_sampler
from otc_dist.otc.alpha import Alpha
from otc_dist.otc.distances.interface import Setting
from otc_dist.otc.samplers.interface import MergedData, Preparation, Sampler
from otc_dist.otc.samplers.offline import offline_sampler, prepared
from otc_dist.randomness import stream
from otc_dist.spec import AgentSpec, Task
from otc_dist.steps.engine import Engine
from otc_dist.steps.noise import to_arrays, to_tensors
from otc_dist.steps.state import State
from otc_dist.transitions import Float32, RowLayout, Transitions

SAVE_EVERY = 10_000  # offline updates between two checkpoints


class Learner:
    """One agent: its data, its replay buffer, its sampler and its policy, and nobody else's.

    Args:
        data: B_0.
        task: what the task asks for, if the environment says; algorithms that plan need it.
        place: the agent's number and the size of its team, for tuning in turns.
        sampler: in place of the described one: an analysis's, who may know more than an agent.
        fits: further distances whose fits to B_0 `pretrain` makes and checkpoints keep, for other
            descriptions that start from the same policy.

    Attributes:
        tuned: k of the policy pi_k it holds; -1 before pi_0.
        together: the seeds whose offline updates were made at once; empty: its own alone.

    Raises:
        UserError: the engine cannot run here, or the algorithm does not fit the agent.
        ValueError: data of other sizes than the agent's, that are not finite, or with an action
            that was not available.
    """

    def __init__(
        self,
        description: Description,
        spec: AgentSpec,
        data: Transitions,
        task: Task | None = None,
        place: tuple[int, int] = (0, 1),
        sampler: Sampler | None = None,
        fits: Iterable[str] = (),
    ) -> None:
        self.description, self.spec, self._place = description, spec, place
        self.tuned = -1
        self.together: tuple[int, ...] = ()
        self._agent = spec.name
        self._offline_updates = 0
        deployments = description.deployment
        updates = description.offline.updates + deployments.count * deployments.updates
        self._engine = Engine.of(description.engine, updates)

        algorithm = description.algorithm
        self._layout = RowLayout(spec.observation_size, spec.action_size, spec.choices)
        self._algorithm = create(algorithm, spec, task)
        self._actor = Actor(description, spec, self._algorithm)
        critic = self._algorithm if isinstance(self._algorithm, Critic) else None
        setting = Setting(description, self._layout, critic)
        self._fits = Fits(setting, self._engine, fits)
        self._experience = Experience(
            self._layout,
            self._actor.scale,
            data,
            deployments.count * deployments.transitions,
            self._fits.own,
            self._engine.device,
            folded=bool(self._fits),
        )
        self._improvements = improvements(self._algorithm)
        self._offline_sampler = offline_sampler(setting)
        self._sampler = sampler or create_sampler(setting, self._experience.capacity)
        self._kept: Mapping[str, float] = {}
        offline = unpack(self._experience.offline.cpu(), self._layout)
        initial = self._algorithm.initial_state(self._stream("initial"), offline)
        self._state: State = to_tensors(initial, self._engine.device)
        step = fused_update(self._engine, self._algorithm, self._layout)
        self._offline, self._online = (
            Trainer(
                self._algorithm,
                sampler,
                step,
                self._layout,
                algorithm.batch_size,
                self._engine,
                self._stream,
            )
            for sampler in (self._offline_sampler, self._sampler)
        )

    @property
    def alpha(self) -> Alpha:
        """alpha_k and the expected similarity 𝔻_k it was adapted to, where the sampler has them."""
        kept = self._kept or self._sampler.kept
        return Alpha(kept.get("alpha", 1.0), kept.get("similarity", math.nan))

    @property
    def policy(self) -> tuple[Algorithm, State]:
        """The algorithm and all that it has learned so far: an analysis asks it at other states."""
        return self._algorithm, self._state

    def pretrain(self, report: Report, save: Callable[[], None]) -> None:
        """Train pi_0 on B_0, and what the distance fits to it: whatever is left to do.

        Args:
            save: called every SAVE_EVERY updates, to keep an unfinished state.
        """
        updates = self.description.offline.updates
        total = updates + self._improvements

        def on_block(state: State, done: int, metrics: dict[str, float]) -> None:
            if done <= updates:
                self.take_over(state, done)
            report(Progress("offline", 0, done, total, metrics))
            if (done % SAVE_EVERY == 0 or done == updates) and done < total and done <= updates:
                save()

        def on_fit(name: str, done: int, of: int, metrics: dict[str, float]) -> None:
            report(Progress(name, 0, done, of, metrics))

        if self._offline_updates < total:
            trainer, work = self.offline
            if self.description.offline.rows == "typical":
                self._fits.train(self._experience, self._stream, on_fit, "typical")
                data = prepared(self._offline_sampler, self._held(0), self._fits.of("typical"))
                work = work._replace(data=data)
            self.take_over(trainer.train(work, on_block), total)
        self._fits.train(self._experience, self._stream, on_fit)
        self.tuned = max(self.tuned, 0)

    @property
    def offline(self) -> tuple[Trainer, Work]:
        """The updates that pi_0 has yet to see, of all rows of B_0, and what makes them."""
        held, span = self._experience, (self._offline_updates, self.description.offline.updates)
        phase = Phase("offline", 0, 0)  # offline training is common to all minibatch keys
        return self._offline, Work(self._state, held.data, held.extent, phase, span)

    def take_over(self, state: State, done: int) -> None:
        """Hold the state after so many offline updates, made here or for several seeds at once."""
        self._state, self._offline_updates = state, done

    def act(
        self,
        observations: Float32,
        phase: ActingPhase,
        deployment: int,
        step: int,
        *,
        exploring: bool = False,
    ) -> Float32:
        """Actions (E, action_size) of the policy it holds, for observations (E, s).

        A pure function of the policy and the arguments, so that answering twice is harmless.

        Raises:
            UserError: an observation whose mask has no available action.
        """
        return self._actor.act(
            self._state, observations, phase, deployment, step, exploring=exploring
        )

    def tune(self, deployment: int, data: Transitions, report: Report) -> None:
        """Merge D_k, measure, and make L updates (lines 5 to 16 of Algorithm 1).

        Where agents tune in turns, the updates are made at every N-th deployment only. Optimizers
        and targets are kept from before. Afterwards `tuned == deployment`.

        Raises:
            ValueError: not the deployment after `tuned`, or data that are not finite.
        """
        if deployment != self.tuned + 1:
            raise ValueError(f"cannot tune on deployment {deployment} after {self.tuned}")
        self._experience.merge(data)
        updates = self.description.deployment.updates
        total = updates + self._improvements
        index, agents = self._place
        if self.description.deployment.turns and (deployment - 1) % agents != index:
            report(Progress("tuning", deployment, total, total, {}))
            self.tuned = deployment
            return
        begun = self._begin(deployment)
        report(Progress("tuning", deployment, 0, total, dict(begun.measured)))

        def on_block(state: State, done: int, metrics: dict[str, float]) -> None:
            report(Progress("tuning", deployment, done, total, metrics))

        state, extent = {**self._state, **begun.changed}, self._experience.extent
        phase = Phase("tuning", deployment, self.description.minibatch_key)
        work = Work(state, begun.data, extent, phase, (0, updates))
        self._state = self._online.train(work, on_block)
        self.tuned = deployment

    def _begin(self, deployment: int) -> Preparation:
        """What the sampler prepares; what it keeps for the next deployment is kept."""
        with torch.no_grad():
            begun = self._sampler.begin(self._held(deployment))
        self._kept = begun.kept
        return begun

    def _held(self, deployment: int) -> MergedData:
        return MergedData(
            self._state,
            self._experience.data,
            self._experience.extent,
            self._engine,
            lambda purpose, *key: self._stream(purpose, deployment, *key),
            self._kept,
        )

    def policy_digest(self) -> str:
        """16 hexadecimal digits that identify the policy and all that updates it, to the bit."""
        return checkpoint.digest(checkpoint.joined({"algorithm": to_arrays(self._state)}))

    def save(self, path: Path) -> None:
        """Write a checkpoint, atomically. Raises UserError if it cannot be written."""
        states = {"algorithm": self._state, **self._fits.states()}
        arrays = checkpoint.joined({name: to_arrays(state) for name, state in states.items()})
        checkpoint.write(path, arrays, self._metadata())

    def load(self, path: Path) -> None:
        """Take over a checkpoint's state; `restore` then merges D_1 .. D_tuned again.

        If a checkpoint of offline training lacks what this description's distance fits to B_0,
        `pretrain` fits it.

        Raises:
            UserError: missing, damaged, or not this learner's: see `checkpoint.read_own`.
        """
        states, found = checkpoint.read_own(path, self._metadata())
        self._state = to_tensors(states["algorithm"], self._engine.device)
        self._offline_updates = found.offline_updates
        self.tuned, self.together = found.tuned, found.together
        if not self._fits.load(states, self._experience, self._stream):
            self.tuned = -1
        if found.tuned > 0:
            self._kept = {"alpha": found.alpha, "similarity": found.similarity}

    def check(self, path: Path) -> None:
        """Whether `load` could take over a checkpoint. Raises UserError as it does."""
        checkpoint.read_own(path, self._metadata())

    def restore(self, online: Sequence[Transitions]) -> None:
        """After `load`: merge D_1 .. D_tuned again, in order."""
        for data in online:
            self._experience.merge(data)

    def revert(self, path: Path) -> None:
        """Go on from an earlier policy: its weights, targets and optimizers, to be tuned by `tune`.

        Everything else stays: all data, alpha, and what the sampler knows of them.

        Raises:
            UserError: as `load`.
        """
        earlier = checkpoint.read_own(path, self._metadata())[0]["algorithm"]
        own = {name: x for name, x in self._state.items() if name.startswith("sampler_")}
        kept = {name: x for name, x in earlier.items() if not name.startswith("sampler_")}
        self._state = {**to_tensors(kept, self._engine.device), **own}

    def _stream(self, *key: int | str) -> np.random.Generator:
        return stream(self.description.seed, self._agent, *key)

    def _metadata(self) -> checkpoint.CheckpointMetadata:
        return checkpoint.CheckpointMetadata(
            agent=self._agent,
            offline_digest=self.description.offline_digest(),
            run_digest=self.description.tuning_digest(),
            offline_updates=self._offline_updates,
            tuned=self.tuned,
            alpha=self.alpha.value,
            similarity=self.alpha.similarity,
            together=self.together,
        )
