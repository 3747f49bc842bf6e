"""An agent's brain: pretrain, act, tune, checkpoint (Algorithm 1). It knows no bus and no
environment.

    learner = Learner(description, spec, data)
    learner.pretrain(report, save)                                  # pi_0
    for k in 1..K:
        actions = learner.act(observations, "deployment", k, step)  # by pi_{k-1}, M / E times
        learner.tune(k, own_transitions, report)                    # pi_k

Everything random is keyed by (seed, agent, purpose, deployment, step or block of updates).
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
import torch

from otc_dist.algorithms import create
from otc_dist.algorithms.interface import Algorithm, Critic, unpack
from otc_dist.description import Description
from otc_dist.learner.actor import ActingPhase, Actor
from otc_dist.learner.experience import Experience
from otc_dist.learner.fits import Fits
from otc_dist.learner.learned import Learned
from otc_dist.learner.trainer import (
    Phase,
    Progress,
    Report,
    Trainer,
    Work,
    fused_update,
    goes_back,
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
from otc_dist.steps.noise import to_tensors
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
        offline = unpack(self._experience.offline.cpu(), self._layout)
        initial = self._algorithm.initial_state(self._stream("initial"), offline)
        self._learned = Learned(
            description,
            spec.name,
            self._engine.device,
            self._fits,
            to_tensors(initial, self._engine.device),
            self._sampler.kept,
        )
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
        return self._learned.alpha

    @property
    def tuned(self) -> int:
        """k of the policy pi_k it holds; -1 before pi_0."""
        return self._learned.tuned

    @property
    def together(self) -> tuple[int, ...]:
        """The seeds whose offline updates were made at once; empty: its own alone."""
        return self._learned.together

    @property
    def policy(self) -> tuple[Algorithm, State]:
        """The algorithm and all that it has learned so far: an analysis asks it at other states."""
        return self._algorithm, self._learned.state

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

        if self._learned.offline_updates < total:
            trainer, work = self.offline
            if self.description.offline.rows == "typical":
                self._fits.train(self._experience, self._stream, on_fit, "typical")
                data = prepared(self._offline_sampler, self._held(0), self._fits.of("typical"))
                work = work._replace(data=data)
            self.take_over(trainer.train(work, on_block), total)
        self._fits.train(self._experience, self._stream, on_fit)
        self._learned.tuned = max(self.tuned, 0)

    @property
    def offline(self) -> tuple[Trainer, Work]:
        """The updates that pi_0 has yet to see, of all rows of B_0, and what makes them."""
        held, learned = self._experience, self._learned
        phase = Phase("offline", 0, 0)  # offline training is common to all minibatch keys
        span = (learned.offline_updates, self.description.offline.updates)
        return self._offline, Work(learned.state, held.data, held.extent, phase, span)

    def take_over(self, state: State, done: int, together: tuple[int, ...] = ()) -> None:
        """Hold the state after so many offline updates, made here or for several seeds at once."""
        self._learned.state, self._learned.offline_updates = state, done
        if together:
            self._learned.together = together

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
            self._learned.state, observations, phase, deployment, step, exploring=exploring
        )

    def tune(self, deployment: int, data: Transitions, report: Report) -> None:
        """Merge D_k, measure, and make L updates (lines 5 to 16 of Algorithm 1).

        An algorithm that improves its policy afterwards does so from the one that was deployed.
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
            self._learned.tuned = deployment
            return
        begun = self._begin(deployment)
        report(Progress("tuning", deployment, 0, total, dict(begun.measured)))

        def on_block(state: State, done: int, metrics: dict[str, float]) -> None:
            report(Progress("tuning", deployment, done, total, metrics))

        state, extent = {**self._learned.state, **begun.changed}, self._experience.extent
        phase = Phase("tuning", deployment, self.description.minibatch_key)
        work = Work(state, begun.data, extent, phase, (0, updates))
        self._learned.state = self._online.train(work, on_block)
        self._learned.tuned = deployment

    def _begin(self, deployment: int) -> Preparation:
        """What the sampler prepares; what it keeps for the next deployment is kept."""
        with torch.no_grad():
            begun = self._sampler.begin(self._held(deployment))
        self._learned.sampler = begun.kept
        return begun

    def _held(self, deployment: int) -> MergedData:
        return MergedData(
            self._learned.state,
            self._experience.data,
            self._experience.extent,
            self._engine,
            lambda purpose, *key: self._stream(purpose, deployment, *key),
            self._learned.sampler,
        )

    def policy_digest(self) -> str:
        """16 hexadecimal digits that identify the policy and all that updates it, to the bit."""
        return self._learned.digest()

    def save(self, path: Path) -> None:
        """Write a checkpoint, atomically. Raises UserError if it cannot be written."""
        self._learned.save(path)

    def load(self, path: Path) -> None:
        """Take over a checkpoint's state; `restore` then merges D_1 .. D_tuned again.

        If a checkpoint of offline training lacks what this description's distance fits to B_0,
        `pretrain` fits it.

        Raises:
            UserError: missing, damaged, or not this learner's.
        """
        if not self._fits.load(self._learned.load(path), self._experience, self._stream):
            self._learned.tuned = -1

    def check(self, path: Path) -> None:
        """Whether `load` could take over a checkpoint. Raises UserError as it does."""
        self._learned.check(path)

    def restore(self, online: Sequence[Transitions]) -> None:
        """After `load`: merge D_1 .. D_tuned again, in order."""
        for data in online:
            self._experience.merge(data)

    def revert(self, path: Path) -> None:
        """Go on from an earlier policy: its weights, targets and optimizers, to be tuned by `tune`.

        Everything else stays: all data, alpha, what the sampler knows of them, and an algorithm's
        models of the data.

        Raises:
            UserError: as `load`.
        """
        self._learned.revert(path, goes_back(self._algorithm, self._learned.state))

    def _stream(self, *key: int | str) -> np.random.Generator:
        return stream(self.description.seed, self.spec.name, *key)
