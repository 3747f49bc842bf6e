"""What the updates have in common: networks as lists of (weight, bias), Adam, and targets."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.nn import relu

Tree = Any  # a nest of dictionaries, lists and arrays
Batch = tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]
Update = Callable[[Tree, Tree, Tree, Batch, jax.Array], tuple[Tree, Tree, Tree]]


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
