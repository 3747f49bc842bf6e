"""The update of CQL for discrete actions in JAX."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.nn import logsumexp

from otc_dist.algorithms.discrete_cql import DiscreteCqlSection
from otc_dist.spec import AgentSpec

from .parts import Algorithm, Batch, Tree, apply, descend, follow, mlp


def algorithm(section: DiscreteCqlSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
    choices = spec.choices
    parameters = {"critic": mlp(key, spec.observation_size, *section.hidden, choices)}

    def masked(values: jax.Array, s: jax.Array) -> jax.Array:
        return jnp.where(s[:, -choices:] > 0, values, -jnp.inf)

    def update(p: Tree, targets: Tree, adam: Tree, batch: Batch, key: jax.Array) -> Any:
        s, a, r, next_s, done = batch
        rows = jnp.arange(len(s))
        greedy = masked(apply(p["critic"], next_s), next_s).argmax(1)
        following = apply(targets["critic"], next_s)[rows, greedy]
        target = r + section.discount * (1 - done) * following

        def loss(critic: Tree) -> jax.Array:
            values = apply(critic, s)
            q = values[rows, a[:, 0].astype(int)]
            error = jnp.abs(q - target)
            huber = jnp.where(error < 1, 0.5 * error**2, error - 0.5).mean()
            return huber + section.weight * (logsumexp(masked(values, s), 1) - q).mean()

        p["critic"], adam["critic"] = descend(
            p["critic"], jax.grad(loss)(p["critic"]), adam["critic"], section.critic_learning_rate
        )
        return p, follow(targets, p, section.target_rate), adam

    return Algorithm(parameters, ("critic",), update)
