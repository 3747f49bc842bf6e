"""A trained policy by itself: loaded from a run or a checkpoint, to act or to be exported.

policy = Policy.load("runs/3agent_hopper-seed0", agent="agent_0")
actions = policy.act(observations)  # (E, observation_size) -> (E, action_size)
policy.export("agent_0.onnx")
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import numpy as np
import torch
from numpy.typing import ArrayLike

from otc_dist.algorithms import create
from otc_dist.description import Description, user_code
from otc_dist.envs import registry
from otc_dist.learner import checkpoint, policy_export
from otc_dist.learner.actor import ActingPhase, Actor
from otc_dist.learner.policy_choice import chosen
from otc_dist.spec import AgentSpec
from otc_dist.steps.noise import to_tensors
from otc_dist.steps.state import State
from otc_dist.system import durable
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32, all_finite

_MOST_NOISE = 2**24  # random numbers for one observation; more is a mistake in a file, or worse


class Policy:
    """One agent's policy pi_k: it acts, says what it is, and is exported.

    `Policy.load` makes one. It needs no data set, no bus and no simulator, and computes on the CPU.

    Attributes:
        spec: the agent's own interface: name, sizes, bounds, discrete choices.
        deployment: k, of the deployment on whose data it was tuned last; 0: trained offline only.
        digest: 16 hexadecimal digits that identify it and all that updates it, to the bit; logs
            and evaluations name the policies that acted by it.
        description: of the run that made it.
    """

    def __init__(
        self,
        actor: Actor,
        state: State,
        deployment: int,
        digest: str,
    ) -> None:
        self._actor, self._state = actor, state
        self.spec: AgentSpec = actor.spec
        self.deployment: int = deployment
        self.digest: str = digest
        self.description: Description = actor.description

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        agent: str | None = None,
        deployment: int | None = None,
        allow: str | Iterable[str] = (),
    ) -> Self:
        """Load a policy that a run made.

        Args:
            path: a run's folder, or one checkpoint in it (`RUN/agents/AGENT/checkpoint_03.*`): the
                run's `description.toml` says what the tensors of a checkpoint mean.
            agent: whose policy, by name; may be left out where there is one agent.
            deployment: k of pi_k, the policy tuned on the deployments 1 .. k; 0 is the offline one.
                Left out, it is the one that the finished run recommends.
            allow: `module:function` of an environment of your own, as the run names it. Nothing
                that a file names is imported without it.

        Raises:
            UserError: one line that says what is missing, damaged, ambiguous or not allowed.
        """
        user_code.allow_all(allow)
        found = chosen(Path(path), agent, deployment)
        return cls.of_checkpoint(found.checkpoint, found.description, found.agent)

    @classmethod
    def of_checkpoint(
        cls, path: Path, description: Description, spec: AgentSpec, device: str = "cpu"
    ) -> Self:
        """The policy in a checkpoint of an agent whose run was described so.

        Args:
            device: where it acts; a run's engine decides where its own learners did.

        Raises:
            UserError: the checkpoint is missing, damaged, unfinished, of another agent, or not of
                such an algorithm.
        """
        arrays, found = checkpoint.read(path)
        if found.agent != spec.name:
            raise UserError(f"the checkpoint {path} is {found.agent}'s, not {spec.name}'s")
        if found.tuned < 0:
            raise UserError(f"the checkpoint {path} is of unfinished offline training")
        own = {name: array for name, array in arrays.items() if name.startswith("algorithm.")}
        task = registry.task(description.env.id)
        actor = Actor(description, spec, create(description.algorithm, spec, task))
        learned = to_tensors(checkpoint.parts(own).get("algorithm", {}), torch.device(device))
        state = _needed(actor, learned, path)
        return cls(actor, state, found.tuned, checkpoint.digest(own))

    def act(self, observations: ArrayLike, step: int = 0) -> Float32:
        """What the policy does, without exploration.

        A pure function: the same policy, observations and step give the same actions, to the bit
        on one kind of processor. They are those of the run's own greedy episodes (evaluation k).

        Args:
            observations: (E, observation_size), of E copies of the agent, or (observation_size,)
                of one. With discrete actions the last `spec.choices` entries say which are
                available (1) and which are not (0).
            step: of the episode, from 0. A policy's noise depends on it (BCQ); most
                policies need none.

        Returns:
            Actions (E, action_size), or (action_size,), float32, within the agent's bounds and in
            its own units; of discrete ones the index.

        Raises:
            ValueError: another shape, or a number that is not finite.
            UserError: a mask without an available action.
        """
        given = np.asarray(observations, np.float32)
        rows = np.atleast_2d(given)
        if given.ndim not in (1, 2) or rows.shape[1] != self.spec.observation_size:
            raise ValueError(
                f"observations of {self.spec.name} have shape (E, {self.spec.observation_size}),"
                f" not {given.shape}"
            )
        if not all_finite(rows):
            raise ValueError(f"an observation of {self.spec.name} is not finite (NaN or infinity)")
        actions = self.act_as(rows, "evaluation", self.deployment, step)
        return actions if given.ndim == 2 else actions[0]

    def act_as(
        self,
        observations: Float32,
        phase: ActingPhase,
        deployment: int,
        step: int,
        *,
        exploring: bool = False,
    ) -> Float32:
        """What the learner did, or would do, at a moment of its run; see `Actor.act`."""
        with _one_thread():
            return self._actor.act(
                self._state, observations, phase, deployment, step, exploring=exploring
            )

    def noise(self, copies: int = 1, step: int = 0) -> dict[str, Float32]:
        """The random numbers by which `act` answers: what an exported policy takes as inputs.

        Empty for most policies. For `copies` observations each array has as many rows.
        """
        return self._actor.noise("evaluation", self.deployment, step, copies)

    def export(self, path: str | Path) -> None:
        """Write the policy as `.onnx` or `.pt2`, to run without otc_dist.

        Inputs: `observations` (E, observation_size), float32, and what `noise` names; output:
        `actions` (E, action_size), as `act` gives them. In the file, under `otc_dist` (of a .pt2:
        `otc_dist.json`), stands whose policy it is and how its random inputs are distributed.

        Raises:
            UserError: another ending, a file that cannot be written, or ONNX without
                `otc-dist[onnx]`.
        """
        path = Path(path)
        about = {
            "agent": self.spec.name,
            "environment": self.description.env.id,
            "deployment": self.deployment,
            "digest": self.digest,
        }
        durable.put(path, policy_export.export(self._actor, self._state, about, path.suffix))

    def __repr__(self) -> str:
        name = self.description.algorithm.name
        return f"<Policy {self.digest}: {name}, pi_{self.deployment} of {self.spec.name}>"


def _needed(actor: Actor, learned: State, path: Path) -> State:
    """What the algorithm reads to act; all else in a checkpoint is for updates.

    Raises:
        UserError: it cannot act by this.
    """
    specs = actor.algorithm.acting_noise_spec(1)
    if sum(np.prod(shape, dtype=np.float64) for _, shape in specs.values()) > _MOST_NOISE:
        raise UserError(f"the run of {path} needs too many random numbers for one observation")
    seen = _RecordingState(learned)
    ones = np.ones((1, actor.spec.observation_size), np.float32)
    try:
        actions = actor.act(seen, ones, "evaluation", 0, 0)
    except (KeyError, IndexError, RuntimeError, TypeError, ValueError, StopIteration):
        name = actor.description.algorithm.name
        raise UserError(
            f"the checkpoint {path} holds no policy of {name} for {actor.spec.name}, as its run's"
            " description says"
        ) from None
    needed = {name: learned[name] for name in seen.names}
    if not (all_finite(actions) and all(tensor.isfinite().all() for tensor in needed.values())):
        raise UserError(f"the policy in the checkpoint {path} holds numbers that are not finite")
    return needed


class _RecordingState(State):
    """A state that notes which of its tensors are read."""

    def __init__(self, state: State) -> None:
        super().__init__(state)
        self.names: set[str] = set()

    def __getitem__(self, name: str) -> torch.Tensor:
        self.names.add(name)
        return super().__getitem__(name)


@contextmanager
def _one_thread() -> Iterator[None]:
    """As learners compute: sums that are split over threads round differently."""
    before = torch.get_num_threads()
    if before == 1:  # to set it is not free
        yield
        return
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
