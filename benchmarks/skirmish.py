"""How many steps a second does the skirmish make, in one process?

    python benchmarks/skirmish.py [--rounds 7]

A step of E copies counts as E. All rows play random available actions, with an observation after
every step and a reset of every battle that has ended. The peer is SMAX (pip install
'otc-dist[smax]'; left out where it is missing), whose rules are simpler in some ways and richer
in others:

- through our adapter, as an env host steps it;
- in its own way: many steps compiled into one, actions drawn and copies reset inside.

All rows take turns, round after round. A time is the processor's for this process, all threads,
so that other load on the machine counts little; a ratio is the median over the rounds.
"""

import argparse

import numpy as np
from stepping import Row, alternate

from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError, run_main

NATIVE, SMAX = "5m_vs_6m", "smax/5m_vs_6m"
TURN = 4000  # steps of all copies together, about


def batched(env_id: str, copies: int) -> Row:
    env, random = registry.make(env_id, copies), np.random.default_rng(0)
    choices = env.spec.agents[0].choices
    env.reset(np.arange(copies), random.integers(2**62, size=copies))
    rounds = max(TURN // copies, 20)

    def turn() -> None:
        for _ in range(rounds):
            seen = np.stack(env.observe())
            keys = random.random((*seen.shape[:2], choices), np.float32)
            actions = (keys * seen[:, :, -choices:]).argmax(axis=2)
            outcome = env.step(list(actions[:, :, None].astype(np.float32)))
            (ended,) = (outcome.terminated | outcome.truncated).nonzero()
            if len(ended):
                env.reset(ended, random.integers(2**62, size=len(ended)))

    return Row(f"{env_id}, {copies:,} copies", rounds * copies, turn)


def compiled_smax(copies: int) -> Row:
    import jax
    from jaxmarl import make
    from jaxmarl.environments.smax import map_name_to_scenario

    game = make("HeuristicEnemySMAX", scenario=map_name_to_scenario(NATIVE))
    length = max(TURN // copies, 20)

    def play(key, state):  # type: ignore[no-untyped-def]
        draw, go, key = jax.random.split(key, 3)
        masks = game.get_avail_actions(state)
        draws = jax.random.split(draw, len(game.agents))
        actions = {
            name: jax.random.categorical(draws[i], jax.numpy.log(masks[name].astype(float)))
            for i, name in enumerate(game.agents)
        }
        seen, state, *_ = game.step(go, state, actions)
        return key, state, seen

    @jax.jit
    def scan(keys, states):  # type: ignore[no-untyped-def]
        def step(carry, _):  # type: ignore[no-untyped-def]
            keys, states, seen = jax.vmap(play)(*carry)
            return (keys, states), sum(x.sum() for x in seen.values())

        return jax.lax.scan(step, (keys, states), None, length)

    keys = jax.random.split(jax.random.PRNGKey(0), copies)
    now = [keys, jax.jit(jax.vmap(game.reset))(keys)[1]]

    def turn() -> None:
        carry, total = scan(*now)
        total.block_until_ready()
        now[:] = carry

    return Row(f"SMAX compiled, {copies:,} copies", length * copies, turn)


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description="Steps a second of the skirmish beside SMAX.")
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args(argv).rounds
    rows = [batched(NATIVE, copies) for copies in (1, 16, 64, 256)]
    try:
        rows += [batched(SMAX, copies) for copies in (1, 64)]
        rows += [compiled_smax(copies) for copies in (64, 1024)]
    except UserError as missing:
        print(f"without SMAX: {missing}")
    alternate(rows, rounds)
    reference = rows[2]
    print(f"medians of {rounds} alternating turns; the ratio is of {reference.name} to the row")
    for row in rows:
        ratio = reference.times_as_fast_as(row)
        print(f"{row.name:32} {row.median:>12,.0f} steps/s {ratio:8.2f}x")
    return 0


if __name__ == "__main__":
    run_main(main)
