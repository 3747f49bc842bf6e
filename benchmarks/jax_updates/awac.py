"""AWAC's update in JAX."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.nn import sigmoid, softmax

from otc_dist.algorithms.awac import AwacSection
from otc_dist.spec import AgentSpec

from .parts import Algorithm, Batch, Tree, apply, both, descend, follow, mlp, twin_loss


def algorithm(section: AwacSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
    s_size, a_size, hidden = spec.observation_size, spec.action_size, section.hidden
    keys = jax.random.split(key, 3)
    parameters = {
        "critic": [mlp(k, s_size + a_size, *hidden, 1) for k in keys[:2]],
        "actor": {"mean": mlp(keys[2], s_size, *hidden, a_size), "logits": jnp.zeros(a_size)},
    }

    def policy(actor: Tree, s: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jnp.tanh(apply(actor["mean"], s)), 6 * sigmoid(actor["logits"]) - 6

    def sample(actor: Tree, s: jax.Array, key: jax.Array) -> jax.Array:
        mean, log_std = policy(actor, s)
        return (mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape)).clip(-1, 1)

    def update(p: Tree, targets: Tree, adam: Tree, batch: Batch, key: jax.Array) -> Any:
        s, a, r, next_s, done = batch
        first, second = jax.random.split(key)
        q1, q2 = both(targets["critic"], next_s, sample(p["actor"], next_s, first))
        target = r + section.discount * (1 - done) * jnp.minimum(q1, q2)
        value = jnp.minimum(*both(p["critic"], s, sample(p["actor"], s, second)))
        advantage = jnp.minimum(*both(p["critic"], s, a)) - value
        weight = len(s) * softmax(advantage / section.temperature)

        def actor_loss(actor: Tree) -> jax.Array:
            mean, log_std = policy(actor, s)
            density = -0.5 * ((a - mean) / jnp.exp(log_std)) ** 2 - log_std
            return -(weight * density.sum(-1)).mean()

        gradients = {
            "critic": jax.grad(twin_loss)(p["critic"], s, a, target),
            "actor": jax.grad(actor_loss)(p["actor"]),
        }
        rates = {"critic": section.critic_learning_rate, "actor": section.actor_learning_rate}
        for name, gradient in gradients.items():
            p[name], adam[name] = descend(p[name], gradient, adam[name], rates[name])
        return p, follow(targets, p, section.target_rate), adam

    return Algorithm(parameters, ("critic",), update)
