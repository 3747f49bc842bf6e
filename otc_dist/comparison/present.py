"""What agents would do now, in states that they are not in: for analyses, which may ask it."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from otc_dist.algorithms.bcq import Bcq
from otc_dist.learner.action_scale import ActionScale
from otc_dist.learner.learner import Learner
from otc_dist.spec import AgentSpec
from otc_dist.steps.noise import sample_noise, to_tensors
from otc_dist.transitions import Float32, RowLayout, Transitions

CHUNK = 2048  # states asked about at once
CANDIDATES = 10  # actions that BCQ decodes to choose from: a tenth of what it does to act


def would_do(learner: Learner, observations: Float32, random: np.random.Generator) -> Float32:
    """Actions (N, a) of the policy that `learner` holds now, in the environment's units.

    Args:
        observations: (N, s).
        random: for policies that are stochastic, as BCQ's is.
    """
    algorithm, state = learner.policy
    if isinstance(algorithm, Bcq):
        settings = algorithm.settings.model_copy(update={"acting_candidates": CANDIDATES})
        algorithm = replace(algorithm, settings=settings)
    device = next(iter(state.values())).device
    found = []
    with torch.no_grad():
        for start in range(0, len(observations), CHUNK):
            part = torch.tensor(observations[start : start + CHUNK], device=device)
            specs = algorithm.acting_noise_spec(len(part))
            arrays = to_tensors(sample_noise(random, specs, 1), device)
            noise = {name: array[0] for name, array in arrays.items()}
            found.append(algorithm.act(state, part, noise).cpu().numpy())
    return ActionScale(learner.spec).unscaled(np.concatenate(found))


def packed(spec: AgentSpec, data: Transitions) -> Tensor:
    """Packed rows (N, width), as the agent has them: actions scaled to [-1, 1]."""
    layout = RowLayout(spec.observation_size, spec.action_size, spec.choices)
    rows = layout.pack(data)
    actions = rows[:, layout.action]
    actions[:] = ActionScale(spec).scaled(actions)
    return torch.from_numpy(rows)
