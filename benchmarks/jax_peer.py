"""JAX's way: a jitted loop of updates with the sampling inside, data and state on the device.

One call makes as many updates as is best, of LENGTHS, which the first turn finds out. XLA has one
thread, as all others here.
"""

import os
import time
from importlib.util import find_spec
from typing import Any

import numpy as np
from timing import UPDATES

from otc_dist.description.algorithms import AlgorithmSection
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

LENGTHS = (8, 40, 80)  # updates a call; divisors of a turn's
ALGORITHMS = ("bcq", "awac", "cql", "discrete-cql", "td3bc")  # BREMEN has no counterpart


def missing(name: str) -> str:
    """Why `JaxPeer` cannot run algorithm `name`, or nothing."""
    if find_spec("jax") is None:
        return "not installed: pip install -c constraints.txt -e '.[bench]'"
    return "" if name in ALGORITHMS else "not written for it"


class JaxPeer:
    """One algorithm by JAX, which trains on all of `data`."""

    def __init__(self, section: AlgorithmSection, spec: AgentSpec, data: Transitions) -> None:
        os.environ["XLA_FLAGS"] = (
            "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
        )
        import jax
        import jax_updates

        self._jax, self._batch_size = jax, section.batch_size
        self._algorithm = jax_updates.create(section, spec, jax.random.key(0))
        parameters, targets = self._algorithm.parameters, self._algorithm.targets
        optimizers = {name: jax_updates.fresh(part) for name, part in parameters.items()}
        own = {name: jax.tree.map(lambda x: x.copy(), parameters[name]) for name in targets}
        self._state: Any = (parameters, own, optimizers, jax.random.key(1))
        terminated = data.terminated.astype(np.float32)
        parts = (data.observations, data.actions, data.rewards, data.next_observations, terminated)
        self._data = jax.numpy.asarray(np.column_stack(parts))
        self._borders = np.cumsum([part.shape[1] if part.ndim == 2 else 1 for part in parts])[:-1]
        self._calls = {length: self._call(length) for length in LENGTHS}
        self._length = 0

    def turn(self, number: int) -> float:
        """Milliseconds of processor time an update, over UPDATES updates."""
        if not self._length:
            times = {length: self._time(length, 1) and self._time(length, 3) for length in LENGTHS}
            self._length = min(times, key=times.__getitem__)
        return self._time(self._length, 1)

    def _time(self, length: int, turns: int) -> float:
        start = time.process_time()
        for _ in range(turns * UPDATES // length):
            self._state = self._calls[length](*self._state)
        self._jax.block_until_ready(self._state[0])
        return (time.process_time() - start) * 1e3 / (turns * UPDATES)

    def _call(self, length: int) -> Any:
        jax, borders = self._jax, self._borders

        def one(_: int, state: Any) -> Any:
            parameters, targets, optimizers, key = state
            key, rows, noise = jax.random.split(key, 3)
            chosen = jax.random.randint(rows, (self._batch_size,), 0, len(self._data))
            s, a, r, next_s, done = jax.numpy.split(self._data[chosen], borders, axis=1)
            batch = (s, a, r[:, 0], next_s, done[:, 0])
            made = self._algorithm.update(
                dict(parameters), dict(targets), dict(optimizers), batch, noise
            )
            return *made, key

        def many(*state: Any) -> Any:
            return jax.lax.fori_loop(0, length, one, state)

        return jax.jit(many, donate_argnums=(0, 1, 2))
