"""BCQ's update in JAX."""

from typing import Any

import jax
import jax.numpy as jnp

from otc_dist.algorithms.bcq import BcqSection
from otc_dist.spec import AgentSpec

from .parts import Algorithm, Batch, Tree, apply, both, descend, follow, mlp, one, twin_loss


def algorithm(section: BcqSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
    s_size, a_size, hidden = spec.observation_size, spec.action_size, section.hidden
    latent, count = 2 * a_size, section.target_candidates
    keys = jax.random.split(key, 5)
    parameters = {
        "vae": {
            "encoder": mlp(keys[0], s_size + a_size, *hidden, 2 * latent),
            "decoder": mlp(keys[1], s_size + latent, *hidden, a_size),
        },
        "critic": [mlp(k, s_size + a_size, *hidden, 1) for k in keys[2:4]],
        "actor": mlp(keys[4], s_size + a_size, *hidden, a_size),
    }

    def decode(vae: Tree, s: jax.Array, z: jax.Array) -> jax.Array:
        return jnp.tanh(apply(vae["decoder"], s, z))

    def sample(vae: Tree, s: jax.Array, key: jax.Array) -> jax.Array:
        return decode(vae, s, jax.random.normal(key, (len(s), latent)).clip(-0.5, 0.5))

    def perturbed(actor: Tree, s: jax.Array, a: jax.Array) -> jax.Array:
        return (a + section.perturbation * jnp.tanh(apply(actor, s, a))).clip(-1, 1)

    def update(p: Tree, targets: Tree, adam: Tree, batch: Batch, key: jax.Array) -> Any:
        s, a, r, next_s, done = batch
        keys = jax.random.split(key, 3)

        def vae_loss(vae: Tree) -> jax.Array:
            mean, log_std = jnp.split(apply(vae["encoder"], s, a), 2, -1)
            log_std = log_std.clip(-4, 15)
            z = mean + jnp.exp(log_std) * jax.random.normal(keys[0], mean.shape)
            divergence = -0.5 * (1 + 2 * log_std - mean**2 - jnp.exp(2 * log_std)).mean()
            return ((decode(vae, s, z) - a) ** 2).mean() + 0.5 * divergence

        p["vae"], adam["vae"] = descend(
            p["vae"], jax.grad(vae_loss)(p["vae"]), adam["vae"], section.vae_learning_rate
        )
        repeated = jnp.repeat(next_s, count, 0)
        actions = perturbed(targets["actor"], repeated, sample(p["vae"], repeated, keys[1]))
        q1, q2 = both(targets["critic"], repeated, actions)
        share = section.soft_minimum
        mixed = share * jnp.minimum(q1, q2) + (1 - share) * jnp.maximum(q1, q2)
        target = r + section.discount * (1 - done) * mixed.reshape(-1, count).max(1)
        gradient = jax.grad(twin_loss)(p["critic"], s, a, target)
        p["critic"], adam["critic"] = descend(
            p["critic"], gradient, adam["critic"], section.critic_learning_rate
        )
        sampled = sample(p["vae"], s, keys[2])

        def actor_loss(actor: Tree) -> jax.Array:
            return -one(p["critic"][0], s, perturbed(actor, s, sampled)).mean()

        p["actor"], adam["actor"] = descend(
            p["actor"], jax.grad(actor_loss)(p["actor"]), adam["actor"], section.actor_learning_rate
        )
        return p, follow(targets, p, section.target_rate), adam

    return Algorithm(parameters, ("critic", "actor"), update)
