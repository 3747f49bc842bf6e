"""The update of CQL for continuous actions in JAX."""

import math
from typing import Any

import jax
import jax.numpy as jnp
from jax.nn import logsumexp, softplus

from otc_dist.algorithms.cql import CqlSection
from otc_dist.spec import AgentSpec

from .parts import Algorithm, Batch, Tree, apply, both, descend, follow, mlp, one


def algorithm(section: CqlSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
    s_size, a_size, hidden = spec.observation_size, spec.action_size, section.hidden
    samples = section.action_samples
    keys = jax.random.split(key, 3)
    parameters = {
        "critic": [mlp(k, s_size + a_size, *hidden, 1) for k in keys[:2]],
        "actor": mlp(keys[2], s_size, *hidden, 2 * a_size),
        "log_temperature": jnp.zeros(()),
    }

    def sample(actor: Tree, s: jax.Array, key: jax.Array, *count: int) -> Any:
        """Actions (B, *count, a) of the policy, and their log densities."""
        mean, log_std = jnp.split(apply(actor, s), 2, -1)
        log_std = log_std.clip(-5, 2)
        if count:
            mean, log_std = mean[:, None], log_std[:, None]
        noise = jax.random.normal(key, (len(s), *count, a_size))
        z = mean + jnp.exp(log_std) * noise
        density = -0.5 * noise**2 - log_std - 0.5 * math.log(2 * math.pi)
        return jnp.tanh(z), (density - 2 * (math.log(2) - z - softplus(-2 * z))).sum(-1)

    def values(q: Tree, s: jax.Array, actions: jax.Array) -> jax.Array:
        repeated = jnp.broadcast_to(s[:, None], (*actions.shape[:2], s_size))
        return one(q, repeated, actions)

    def update(p: Tree, targets: Tree, adam: Tree, batch: Batch, key: jax.Array) -> Any:
        s, a, r, next_s, done = batch
        keys = jax.random.split(key, 5)
        next_a, _ = sample(p["actor"], next_s, keys[0])
        target = jnp.minimum(*both(targets["critic"], next_s, next_a))
        target = r + section.discount * (1 - done) * target
        uniform = jax.random.uniform(keys[1], (len(s), samples, a_size), minval=-1, maxval=1)
        current, current_density = sample(p["actor"], s, keys[2], samples)
        following, next_density = sample(p["actor"], next_s, keys[3], samples)

        def critic_loss(twins: Tree) -> jax.Array:
            loss = jnp.zeros(())
            for q in twins:
                parts = (
                    values(q, s, uniform) + a_size * math.log(2),
                    values(q, s, following) - next_density,
                    values(q, s, current) - current_density,
                )
                data = one(q, s, a)
                gap = (logsumexp(jnp.concatenate(parts, 1), 1) - data).mean()
                loss += ((data - target) ** 2).mean() + section.weight * gap
            return loss

        def temperature_loss(log_temperature: jax.Array) -> jax.Array:
            surplus = jax.lax.stop_gradient(sample(p["actor"], s, keys[4])[1] - a_size)
            return -(log_temperature * surplus).mean()

        gradient = jax.grad(temperature_loss)(p["log_temperature"])
        warmth, moments = descend(
            p["log_temperature"], gradient, adam["log_temperature"], section.actor_learning_rate
        )

        def actor_loss(actor: Tree) -> jax.Array:
            chosen, density = sample(actor, s, keys[4])
            return (jnp.exp(warmth) * density - jnp.minimum(*both(p["critic"], s, chosen))).mean()

        gradients = {
            "actor": jax.grad(actor_loss)(p["actor"]),
            "critic": jax.grad(critic_loss)(p["critic"]),
        }
        rates = {"critic": section.critic_learning_rate, "actor": section.actor_learning_rate}
        p["log_temperature"], adam["log_temperature"] = warmth, moments
        for name, gradient in gradients.items():
            p[name], adam[name] = descend(p[name], gradient, adam[name], rates[name])
        return p, follow(targets, p, section.target_rate), adam

    return Algorithm(parameters, ("critic",), update)
