"""How a policy acts: an agent's actions for its observations, and the random numbers for them.

Learners, replays and all code that loads a policy act by this and by nothing else, so that the same
policy gives the same actions, to the bit.
"""

from typing import Literal

import numpy as np
import torch

from otc_dist.algorithms.interface import Algorithm
from otc_dist.description import Description
from otc_dist.learner.action_scale import ActionScale
from otc_dist.randomness import stream
from otc_dist.run.exploration import explore
from otc_dist.spec import AgentSpec
from otc_dist.steps.noise import sample_noise, to_tensors
from otc_dist.steps.state import State
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32

ActingPhase = Literal["deployment", "evaluation"]


class Actor:
    """One agent's way to act by what its algorithm has learned.

    Args:
        description: whose seed all random numbers are keyed by, and how an agent explores.
    """

    def __init__(self, description: Description, spec: AgentSpec, algorithm: Algorithm) -> None:
        self.description, self.spec, self.algorithm = description, spec, algorithm
        self.scale = ActionScale(spec)

    def act(
        self,
        state: State,
        observations: Float32,
        phase: ActingPhase,
        deployment: int,
        step: int,
        *,
        exploring: bool = False,
    ) -> Float32:
        """Actions (E, action_size), in the agent's own units, for observations (E, s).

        A pure function of the state and the arguments, so that answering twice is harmless.

        Raises:
            UserError: an observation whose mask has no available action.
        """
        choices = self.spec.choices
        if choices and not (observations[:, -choices:] > 0).any(axis=1).all():
            raise UserError(
                f"an observation of {self.spec.name} has no available action, at step {step} of"
                f" {phase} {deployment}: the environment must always offer one"
            )
        device = next(iter(state.values())).device
        with torch.no_grad():
            states = torch.tensor(observations, device=device)
            noise = to_tensors(self.noise(phase, deployment, step, len(observations)), device)
            actions: Float32 = self.algorithm.act(state, states, noise).cpu().numpy()
        if actions.shape != (shape := (len(observations), self.spec.action_size)):
            raise ValueError(f"act has to give actions of shape {shape}, not {actions.shape}")
        if exploring:
            settings = self.description.deployment
            random = self._stream("explore", deployment, step)
            actions = explore(actions, observations, choices, settings, random)
        return self.scale.unscaled(actions)

    def noise(
        self, phase: ActingPhase, deployment: int, step: int, copies: int
    ) -> dict[str, Float32]:
        """The random arrays by which `act` answers `copies` observations; of most algorithms none.

        Each has as many rows as there are copies, and the first of them are the same for more.
        """
        specs = self.algorithm.acting_noise_spec(copies)
        arrays = sample_noise(self._stream("act", phase, deployment, step), specs, 1)
        return {name: array[0] for name, array in arrays.items()}

    def _stream(self, *key: int | str) -> np.random.Generator:
        return stream(self.description.seed, self.spec.name, *key)
