"""TD3+BC's update in JAX."""

from typing import Any

import jax
import jax.numpy as jnp

from otc_dist.algorithms.td3bc import Td3BcSection
from otc_dist.spec import AgentSpec

from .parts import Algorithm, Batch, Tree, apply, both, descend, follow, mlp, one, twin_loss


def algorithm(section: Td3BcSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
    s_size, a_size, hidden = spec.observation_size, spec.action_size, section.hidden
    keys = jax.random.split(key, 3)
    parameters = {
        "critic": [mlp(k, s_size + a_size, *hidden, 1) for k in keys[:2]],
        "actor": mlp(keys[2], s_size, *hidden, a_size),
    }

    def update(p: Tree, targets: Tree, adam: Tree, batch: Batch, key: jax.Array) -> Any:
        s, a, r, next_s, done = batch
        noise = (0.2 * jax.random.normal(key, a.shape)).clip(-0.5, 0.5)
        next_a = (jnp.tanh(apply(targets["actor"], next_s)) + noise).clip(-1, 1)
        q1, q2 = both(targets["critic"], next_s, next_a)
        target = r + section.discount * (1 - done) * jnp.minimum(q1, q2)
        gradient = jax.grad(twin_loss)(p["critic"], s, a, target)
        p["critic"], adam["critic"] = descend(
            p["critic"], gradient, adam["critic"], section.critic_learning_rate
        )

        def actor_loss(actor: Tree) -> jax.Array:
            chosen = jnp.tanh(apply(actor, s))
            q = one(p["critic"][0], s, chosen)
            pull = section.q_weight / jax.lax.stop_gradient(jnp.abs(q).mean())
            return ((chosen - a) ** 2).mean() - pull * q.mean()

        def delayed(all_: Tree) -> Tree:
            p, targets, adam = all_
            actor, moments = descend(
                p["actor"],
                jax.grad(actor_loss)(p["actor"]),
                adam["actor"],
                section.actor_learning_rate,
            )
            p, adam = {**p, "actor": actor}, {**adam, "actor": moments}
            return p, follow(targets, p, section.target_rate), adam

        even = adam["critic"]["t"] % 2 == 0
        return jax.lax.cond(even, delayed, lambda unchanged: unchanged, (p, targets, adam))

    return Algorithm(parameters, ("critic", "actor"), update)
