"""`python -m otc_dist.launch.run.compile RUN [AGENT]`: compile updates once, before learners start.

They then load the code from the cache, instead of each compiling the same. What is compiled
depends on the networks' and minibatches' sizes, so a learner with a little made-up data and a few
updates asks for all of it. Only the code of a few samplers depends on the size of the buffer.
"""

import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.learner.learner import Learner
from otc_dist.learner.trainer import Progress
from otc_dist.randomness import stream
from otc_dist.run.folder import RunFolder
from otc_dist.spec import AgentSpec
from otc_dist.steps.engine import compiling
from otc_dist.terminal.errors import run_main
from otc_dist.terminal.progress import beside
from otc_dist.transitions import Transitions

ROWS = 256  # of made-up data
DEPLOYED = 16


def main(argv: list[str]) -> int:
    """Compile for a run.

    `argv`: the run folder, and the agents that learn on this machine (none: all).
    """
    description = Description.load(RunFolder(Path(argv[0])).description).trusted()
    beside("compiling the updates (about a minute; seconds if done before) ...")
    start = time.monotonic()
    compile_updates(description, argv[1:])
    done = f"compiled in {time.monotonic() - start:.0f} s"
    beside(done)
    print(done)  # kept in the run's folder
    return 0


def compile_updates(
    description: Description, names: Sequence[str] = (), fits: Iterable[str] = ()
) -> None:
    """Compile for every agent that differs in its sizes; agents of one size share the code.

    Args:
        names: of the agents; empty: all.
        fits: distances, beside the sampling's own, that fit something to B_0.

    Raises:
        UserError: what this torch compiles is wrong.
    """
    agents = {
        (agent.observation_size, agent.action_size): agent
        for agent in registry.team_spec(description.env.id).agents
        if agent.name in names or not names
    }
    with compiling(description.engine):
        for agent in agents.values():
            _exercise(description, agent, fits)


def _exercise(description: Description, agent: AgentSpec, fits: Iterable[str]) -> None:
    short = description.with_assignments(
        "offline.updates=1", "embedding.updates=1", "deployment.updates=1", "deployment.count=1",
        f"deployment.transitions={DEPLOYED}", "embedding.minimum_active=0",
        "dynamics.updates=1", "dynamics.correction_updates=1", "deployment.turns=false",
    )  # fmt: skip
    short = short.with_assignments(*short.algorithm.brief)
    rows, deployment = ROWS, description.deployment
    if description.sampling.bound:
        online = deployment.count * deployment.transitions
        rows = description.dataset.transitions + online - DEPLOYED
    task = registry.task(description.env.id)
    learner = Learner(short, agent, made_up(agent, rows), task, fits=fits)
    learner.pretrain(_ignore, lambda: None)
    learner.tune(1, made_up(agent, DEPLOYED), _ignore)


def made_up(agent: AgentSpec, rows: int) -> Transitions:
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


def _ignore(progress: Progress) -> None:
    pass


if __name__ == "__main__":
    run_main(main)
