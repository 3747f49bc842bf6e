"""Made-up data, for a learner that needs some to exist and learns nothing from them."""

import numpy as np

from otc_dist.randomness import stream
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions


def stand_in(agent: AgentSpec, rows: int) -> Transitions:
    """`rows` transitions that a learner of `agent` accepts: no episode ends, all is available."""
    random = stream(0, agent.name, "compile", rows)
    low, high = np.array(agent.action_low), np.array(agent.action_high)
    no = np.zeros(rows, dtype=np.bool_)
    observations, next_observations = random.standard_normal(
        (2, rows, agent.observation_size), np.float32
    )
    actions = random.uniform(low, high, (rows, agent.action_size)).astype(np.float32)
    if agent.choices:  # indices, all of them available
        actions = np.rint(actions)
        observations[:, -agent.choices :] = next_observations[:, -agent.choices :] = 1
    return Transitions(
        observations=observations,
        actions=actions,
        rewards=random.standard_normal(rows, np.float32),
        next_observations=next_observations,
        terminated=no,
        truncated=no,
    )
