"""How many steps a second do the particle tasks make, in one process on one thread?

    python benchmarks/particles.py [--rounds 15]

A step of E copies counts as E. All rows play whole episodes of random actions that were drawn
before, with an observation after every step and a reset after every episode. The peer is mpe2's
`simple_spread` (pip install mpe2), whose agents have masses and are moved by forces: nearer to our
Cooperative Navigation, whose agents are points with a velocity, there is none. It has no batch, so
the row that compares like with like is our PettingZoo view of one copy.

All rows take turns, round after round. A time is the processor's for this process, so that other
load on the machine counts little; a ratio is the median over the rounds.
"""

import argparse

import numpy as np
from mpe2 import simple_spread_v3
from pettingzoo import ParallelEnv
from stepping import Row, alternate

from otc_dist.envs import registry
from otc_dist.envs.parallel import ParallelView
from otc_dist.envs.particles import MAX_EPISODE_STEPS
from otc_dist.terminal.errors import run_main

EPISODES = 8  # a turn
AGENTS = 4
STEPS = EPISODES * MAX_EPISODE_STEPS  # a turn, in each of a row's copies


def batched(env_id: str, copies: int) -> Row:
    env, random = registry.make(env_id, copies, 0.0), np.random.default_rng(0)
    high = env.spec.agents[0].action_high[0]
    everyone, seeds = np.arange(copies), random.integers(2**62, size=(EPISODES, copies))
    shape = (MAX_EPISODE_STEPS, len(env.spec.agents), copies, 2)
    actions = [list(step) for step in random.uniform(-high, high, shape).astype(np.float32)]

    def turn() -> None:
        for episode in range(EPISODES):
            env.reset(everyone, seeds[episode])
            for step in actions:
                env.observe()
                env.step(step)

    return Row(f"{env_id}, {copies:,} copies", copies * STEPS, turn)


def pettingzoo(name: str, env: ParallelEnv) -> Row:  # type: ignore[type-arg]
    random = np.random.default_rng(0)
    env.reset(seed=0)
    spaces = {agent: env.action_space(agent) for agent in env.agents}
    actions = [
        {
            agent: random.uniform(space.low, space.high).astype(np.float32)
            for agent, space in spaces.items()
        }
        for _ in range(MAX_EPISODE_STEPS)
    ]

    def turn() -> None:
        for episode in range(EPISODES):
            env.reset(seed=episode)
            for step in actions:
                env.step(step)

    return Row(name, STEPS, turn)


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=15, help="turns of every row")
    arguments = parser.parse_args(argv)
    ours = f"cooperative-navigation-{AGENTS}"
    peer = pettingzoo(
        f"mpe2 simple_spread, {AGENTS} agents",
        simple_spread_v3.parallel_env(
            N=AGENTS, max_cycles=MAX_EPISODE_STEPS, continuous_actions=True
        ),
    )
    rows = [
        peer,
        pettingzoo(f"{ours}, PettingZoo view", ParallelView(registry.make(ours, 1))),
        *(batched(ours, copies) for copies in (1, 16, 1024)),
        batched("cooperative-navigation-32", 16),
        batched("predator-prey-3", 16),
        batched("predator-prey-4", 16),
        batched("navigation", 16),
    ]
    alternate(rows, arguments.rounds)
    print(f"medians of {arguments.rounds} alternating turns of {EPISODES} episodes")
    print(f"{'':40}    steps/s      best  x mpe2")
    for row in rows:
        ratio = row.times_as_fast_as(peer)
        print(f"{row.name:40} {row.median:10,.0f} {max(row.speeds):10,.0f} {ratio:6.1f}")
    return 0


if __name__ == "__main__":
    run_main(main)
