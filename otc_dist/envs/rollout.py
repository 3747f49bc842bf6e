"""Playing a batched environment in lock-step, with every episode's seed known beforehand."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from otc_dist.envs.base import BatchedEnv, Contest, Versioned
from otc_dist.randomness import derive_seed
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32, Float64, JointStep

Phase = Literal["deployment", "evaluation"]


@dataclass(frozen=True)
class Episode:
    """A finished episode."""

    copy: int
    number: int  # 0 for the copy's first episode of this rollout
    team_return: float  # mean over the agents of their sums of rewards
    length: int  # steps
    seed: int
    success: bool | None = None  # whether it was won; None where the task has no such thing


class Rollout:
    """E copies played in lock-step: deterministic autoreset, one `JointStep` per step.

    A copy that ends is reset at once, to an episode whose seed is derived from (seed,
    deployment, copy, episode). In an evaluation it is derived from (seed, copy, episode): all
    deployments and all arms of a comparison are judged on the same episodes, and of each copy
    only so many count as were settled beforehand, because counting those that end in time favours
    short ones. Episodes that the simulator broke off (see `Outcome`) never count: the next one
    does instead.

    The same arguments and actions give the same bytes, so a rollout that was cut off is continued
    by advancing a new one with the logged actions.

    Args:
        episodes: how many an evaluation counts, spread evenly over the copies; None: one per copy.
        begin: whether the first episodes begin at once; else `renew` begins them.
    """

    def __init__(
        self,
        env: BatchedEnv,
        seed: int,
        phase: Phase,
        deployment: int,
        episodes: int | None = None,
        begin: bool = True,
    ) -> None:
        self._env, self._seed, self._phase, self._deployment = env, seed, phase, deployment
        self.step = 0
        self._numbers = np.zeros(env.copies, np.int64)  # which episode each copy is in
        self._seeds = np.zeros(env.copies, np.int64)
        self._returns = np.zeros(env.copies, np.float64)
        self._begun = np.zeros(env.copies, np.int64)  # each copy's episode: at which step
        self._due = np.ones(env.copies, np.int64)  # each copy's episodes still to count
        if episodes is not None:
            self._due = (episodes + env.copies - 1 - np.arange(env.copies)) // env.copies
        self._episodes: list[Episode] = []
        self._over = np.ones(env.copies, np.bool_)  # copies whose next episode has yet to begin
        # What the agents act on now, N x (E, observation_size). Read only: steps share it.
        self.observations: tuple[Float32, ...] = ()
        if begin:
            self.renew()

    @property
    def over(self) -> bool:
        """Whether no episode is under way, in any copy."""
        return bool(self._over.all())

    def renew(self) -> None:
        """Reset the copies whose episodes are over."""
        (which,) = self._over.nonzero()
        if len(which):
            self._reset(which)
            self._over[:] = False
            self.observations = self._env.observe()

    def _reset(self, which: NDArray[np.int64]) -> None:
        for copy in which.tolist():
            number = int(self._numbers[copy])
            if self._phase == "evaluation":
                seed = derive_seed(self._seed, self._phase, copy, number)
            else:
                seed = derive_seed(self._seed, self._phase, self._deployment, copy, number)
            self._seeds[copy] = seed
        self._env.reset(which, self._seeds[which])

    def go_to(self, state: Float64) -> None:
        """Set all copies to `state` (E, state_size), where the environment can be set to one and is
        in another; episodes and their numbers stay.
        """
        if self._env.state().tobytes() == state.tobytes():
            return
        with suppress(UserError):  # of the user's own, whose states can only be compared
            self._env.set_state(state)
            self.observations = self._env.observe()

    def advance(self, actions: Sequence[Float32], exploring: tuple[bool, ...]) -> JointStep:
        """Step all copies with `actions`, N x (E, action_size), and reset those that ended.

        Args and errors as of `play`.
        """
        step = self.play(actions, exploring)
        self.renew()
        return step

    def play(self, actions: Sequence[Float32], exploring: tuple[bool, ...]) -> JointStep:
        """As `advance`, without the resets.

        Args:
            actions: copied, as they were sent (the environment clips its own copy).
            exploring: N behaviour tags, True where the agent explored.

        Raises:
            ValueError: an action of the wrong shape or not finite; nothing has moved then.
        """
        env, observations, state = self._env, self.observations, self._env.state()
        outcome = env.step(actions)
        joint_step = JointStep(
            step=self.step,
            observations=observations,
            actions=tuple([np.array(action, np.float32) for action in actions]),
            rewards=outcome.rewards,
            next_observations=env.observe(),
            terminated=outcome.terminated,
            truncated=outcome.truncated,
            exploring=exploring,
            episode_seeds=self._seeds.copy(),
            state=state,
        )
        self.take(joint_step)
        return joint_step

    def take(self, step: JointStep) -> None:
        """Count the next step, whoever played it: `play`, or the process that logged it."""
        self.step += 1
        self._returns += _mean(step.rewards)
        self.observations = step.next_observations
        self._over = step.terminated | step.truncated
        (ended,) = self._over.nonzero()
        if len(ended):
            self._finish(ended, step.terminated & step.truncated)

    def _finish(self, ended: NDArray[np.int64], broken: Bool) -> None:
        won = self._env.success if isinstance(self._env, Contest) else None
        for copy in ended.tolist():
            if broken[copy] or (self._due[copy] <= 0 and self._phase == "evaluation"):
                continue
            self._due[copy] -= 1
            self._episodes.append(
                Episode(
                    copy,
                    int(self._numbers[copy]),
                    float(self._returns[copy]),
                    self.step - int(self._begun[copy]),
                    int(self._seeds[copy]),
                    None if won is None else bool(won[copy]),
                )
            )
        self._numbers[ended] += 1
        self._returns[ended] = 0.0
        self._begun[ended] = self.step

    @property
    def episodes(self) -> tuple[Episode, ...]:
        """Episodes that count: of a deployment by (end, copy), of an evaluation by copy."""
        if self._phase == "evaluation":
            return tuple(sorted(self._episodes, key=lambda episode: episode.copy))
        return tuple(self._episodes)

    @property
    def episode_returns(self) -> tuple[float, ...]:
        """Team returns of `episodes`, in their order."""
        return tuple(episode.team_return for episode in self.episodes)

    @property
    def episode_lengths(self) -> tuple[int, ...]:
        """Lengths of `episodes` in steps, in their order."""
        return tuple(episode.length for episode in self.episodes)

    @property
    def episode_seeds(self) -> tuple[int, ...]:
        """Seeds of `episodes`, in their order."""
        return tuple(episode.seed for episode in self.episodes)

    @property
    def successes(self) -> tuple[bool, ...] | None:
        """Which of `episodes` were won, in their order; None where the task has no such thing."""
        if not isinstance(self._env, Contest):
            return None
        return tuple(bool(episode.success) for episode in self.episodes)

    @property
    def simulator(self) -> Mapping[str, str]:
        """Versions of a simulator that is more than Python packages; empty of others."""
        return self._env.versions if isinstance(self._env, Versioned) else {}

    @property
    def finished(self) -> bool:
        """Whether every copy has ended its episodes that count: an evaluation is complete."""
        return bool((self._due <= 0).all())


def _mean(rewards: Sequence[Float32]) -> Float32 | Float64:
    """The mean over the agents (E,); a reward that they share is one array."""
    if len(set(map(id, rewards))) == 1:
        return rewards[0]
    total: Float64 = np.add.reduce(rewards, axis=0, dtype=np.float64)
    return total / len(rewards)
