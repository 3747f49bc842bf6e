"""What would BREMEN's updates cost with products in bfloat16, or with models of half the width?

    python benchmarks/bremen_products.py [--rounds 9]

Most of an update of the models and the clone is matrix products. Ours compiled, as it is, takes
turns with the same by torch's products, with torch's in bfloat16 (autocast: parameters, sums and
Adam stay float32), and with an ensemble of half the hidden sizes: 80 updates on one minibatch each,
on one thread, processor time (timing.py).
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from timing import ENVS, Timed, interleave, random_data, repeated

from otc_dist.algorithms.bremen.algorithm import Bremen, BremenSection
from otc_dist.algorithms.bremen.dynamics import Ensemble
from otc_dist.algorithms.interface import Batch, unpack
from otc_dist.envs import registry
from otc_dist.steps.engine import Engine, Products
from otc_dist.steps.noise import to_tensors
from otc_dist.steps.state import State
from otc_dist.terminal.errors import run_main
from otc_dist.transitions import RowLayout

ROWS = 2000  # of the data by which inputs are normalised


@dataclass(frozen=True)
class HalfAsWide(Bremen):
    """BREMEN with models of half the hidden sizes; the clone and the policy keep theirs."""

    @cached_property
    def ensemble(self) -> Ensemble:
        full = super().ensemble
        return Ensemble(
            full.observation_size,
            full.action_size,
            tuple(size // 2 for size in full.hidden),
            full.models,
        )


def updating(
    kind: type[Bremen], products: Products, *, bfloat16: bool = False
) -> Callable[[], None]:
    """Makes one update after another of an algorithm of this kind."""
    env_id, section = ENVS[False], BremenSection()
    spec = registry.team_spec(env_id).agents[0]
    task = registry.task(env_id)
    assert task is not None
    algorithm = kind(spec.observation_size, spec.action_size, section, task)
    layout = RowLayout(spec.observation_size, spec.action_size)
    rows = torch.from_numpy(layout.pack(random_data(spec, ROWS, 0)))
    offline, batch = unpack(rows, layout), unpack(rows[: section.batch_size], layout)

    def update(state: State, batch: Batch) -> State:
        with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
            return algorithm.update(state, batch, batch, {})[0]

    step = Engine("compiled", products).fuse(update)
    state: State = to_tensors(
        algorithm.initial_state(np.random.default_rng(0), offline), torch.device("cpu")
    )

    def one() -> None:
        nonlocal state
        state = step(state, batch)

    return one


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--rounds", type=int, default=9, help="turns of each (9)")
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)
    rows = [
        Timed("as it is", repeated(updating(Bremen, "own"))),
        Timed("torch's products", repeated(updating(Bremen, "torch"))),
        Timed("torch's in bfloat16", repeated(updating(Bremen, "torch", bfloat16=True))),
        Timed("models of half the width", repeated(updating(HalfAsWide, "own"))),
    ]
    interleave(rows, arguments.rounds)
    print(f"torch {torch.__version__}, {torch.backends.cpu.get_cpu_capability()}, one thread")
    print(f"{'one update':<26}{'ms':>7}{'best':>7}{'÷ as it is':>12}")
    for row in rows:
        ratio = row.times_as_slow_as(rows[0])
        print(f"{row.name:<26}{row.median:7.2f}{row.best:7.2f}{ratio:12.2f}")
    return 0


if __name__ == "__main__":
    run_main(main)
