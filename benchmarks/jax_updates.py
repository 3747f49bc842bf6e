"""The algorithms' updates as pure JAX functions: the equations of plain/, which are ours.

Each maps (parameters, targets, optimizers, batch, key) to the first three; networks are lists of
(weight, bias), a batch is (s, a, r, s', terminated).
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.nn import logsumexp, relu, sigmoid, softmax, softplus

from otc_dist.algorithms.awac import AwacSection
from otc_dist.algorithms.bcq import BcqSection
from otc_dist.algorithms.cql import CqlSection
from otc_dist.algorithms.discrete_cql import DiscreteCqlSection
from otc_dist.algorithms.td3bc import Td3BcSection
from otc_dist.description.algorithms import AlgorithmSection
from otc_dist.spec import AgentSpec

Tree = Any  # a nest of dictionaries, lists and arrays
Batch = tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]
Update = Callable[[Tree, Tree, Tree, Batch, jax.Array], tuple[Tree, Tree, Tree]]
stopped = jax.lax.stop_gradient


class Algorithm(NamedTuple):
    """What a peer trains."""

    parameters: Tree
    targets: tuple[str, ...]
    update: Update


def mlp(key: jax.Array, *sizes: int) -> Tree:
    keys = jax.random.split(key, len(sizes))
    return [
        (jax.random.uniform(k, (i, o), minval=-1, maxval=1) / math.sqrt(i), jnp.zeros(o))
        for k, i, o in zip(keys, sizes[:-1], sizes[1:], strict=False)
    ]


def apply(layers: Tree, *inputs: jax.Array) -> jax.Array:
    x = jnp.concatenate(inputs, -1) if len(inputs) > 1 else inputs[0]
    for number, (weight, bias) in enumerate(layers):
        x = (relu(x) if number else x) @ weight + bias
    return x


def one(layers: Tree, *inputs: jax.Array) -> jax.Array:
    return apply(layers, *inputs)[..., 0]


def both(twins: Tree, *inputs: jax.Array) -> tuple[jax.Array, jax.Array]:
    return one(twins[0], *inputs), one(twins[1], *inputs)


def fresh(parameters: Tree) -> Tree:
    m, v = (jax.tree.map(jnp.zeros_like, parameters) for _ in range(2))
    return {"t": jnp.zeros(()), "m": m, "v": v}


def descend(parameters: Tree, gradient: Tree, adam: Tree, rate: float) -> tuple[Tree, Tree]:
    t = adam["t"] + 1
    m = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, adam["m"], gradient)
    v = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, adam["v"], gradient)
    first, second = 1 - 0.9**t, 1 - 0.999**t

    def moved(p: jax.Array, m: jax.Array, v: jax.Array) -> jax.Array:
        return p - rate * (m / first) / (jnp.sqrt(v / second) + 1e-8)

    return jax.tree.map(moved, parameters, m, v), {"t": t, "m": m, "v": v}


def follow(targets: Tree, parameters: Tree, rate: float) -> Tree:
    return {
        name: jax.tree.map(lambda t, p: t + rate * (p - t), target, parameters[name])
        for name, target in targets.items()
    }


def twin_loss(twins: Tree, s: jax.Array, a: jax.Array, target: jax.Array) -> jax.Array:
    return sum(((q - target) ** 2).mean() for q in both(twins, s, a))


def bcq(section: BcqSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
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


def awac(section: AwacSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
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


def td3bc(section: Td3BcSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
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
            pull = section.q_weight / stopped(jnp.abs(q).mean())
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


def cql(section: CqlSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
    s_size, a_size, hidden = spec.observation_size, spec.action_size, section.hidden
    samples = section.action_samples
    keys = jax.random.split(key, 3)
    parameters = {
        "critic": [mlp(k, s_size + a_size, *hidden, 1) for k in keys[:2]],
        "actor": mlp(keys[2], s_size, *hidden, 2 * a_size),
        "log_temperature": jnp.zeros(()),
    }

    def draw(actor: Tree, s: jax.Array, key: jax.Array, *count: int) -> Any:
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
        next_a, _ = draw(p["actor"], next_s, keys[0])
        target = jnp.minimum(*both(targets["critic"], next_s, next_a))
        target = r + section.discount * (1 - done) * target
        uniform = jax.random.uniform(keys[1], (len(s), samples, a_size), minval=-1, maxval=1)
        current, current_density = draw(p["actor"], s, keys[2], samples)
        following, next_density = draw(p["actor"], next_s, keys[3], samples)

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
            surplus = stopped(draw(p["actor"], s, keys[4])[1] - a_size)
            return -(log_temperature * surplus).mean()

        gradient = jax.grad(temperature_loss)(p["log_temperature"])
        warmth, moments = descend(
            p["log_temperature"], gradient, adam["log_temperature"], section.actor_learning_rate
        )

        def actor_loss(actor: Tree) -> jax.Array:
            chosen, density = draw(actor, s, keys[4])
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


def discrete_cql(section: DiscreteCqlSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
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


ALGORITHMS: Mapping[str, Callable[[Any, AgentSpec, jax.Array], Algorithm]] = {
    "bcq": bcq,
    "awac": awac,
    "td3bc": td3bc,
    "cql": cql,
    "discrete-cql": discrete_cql,
}


def create(section: AlgorithmSection, spec: AgentSpec, key: jax.Array) -> Algorithm:
    return ALGORITHMS[section.name](section, spec, key)
