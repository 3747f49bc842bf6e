"""What does each part of torch buy that torch does not promise to keep?

    python benchmarks/torch_internals.py [--only awac,td3bc] [--rounds 12]

The same learner, compiled with all of them, and with one or all left out; they take turns of 80
updates, on one thread (timing.py). Where all are left out, that is plain `torch.compile`.
"""

import argparse
from collections.abc import Callable
from unittest.mock import patch

import torch
from algorithms import tuned
from timing import Timed, interleave, say, sections, tuning

from otc_dist.steps import engine, torch_internals
from otc_dist.terminal.errors import run_main, unknown

# What is left out: options of torch.compile, passes of its compiler, and direct calls. Our products
# need the C++ wrapper.
PYTHON = ("Products", "cpp_wrapper", "size_asserts", "direct")
WITHOUT = {
    "all of it": (),
    "products by torch": ("Products",),
    "equal terms computed again": ("RepeatedTerms",),
    "calls through torch": ("direct",),
    "and all guards checked": ("direct", "guard_filter_fn"),
    "no C++ wrapper": PYTHON,
    "plain torch.compile": (
        *(*PYTHON, "RepeatedTerms", "guard_filter_fn"),
        "unsafe_marked_cacheable_functions",
    ),
}
PASSES = "post_grad_custom_pre_pass"
OPTIONS, DIRECTLY = torch_internals.options, torch_internals.called_directly


def variant(name: str, left_out: str, rounds: int) -> Timed:
    """The tuning of algorithm `name` without some of it."""
    without = WITHOUT[left_out]

    def options(*arguments: object, **named: object) -> dict[str, object]:
        chosen = OPTIONS(*arguments, **named)  # type: ignore[arg-type]
        passes = [one for one in chosen[PASSES] if type(one).__name__ not in without]
        return {key: item for key, item in chosen.items() if key not in without} | {PASSES: passes}

    def called_directly(compiled: Callable[..., object]) -> Callable[..., object]:
        return compiled if "direct" in without else DIRECTLY(compiled)

    engine._fused.clear()  # what was compiled with other options
    with (
        patch.object(torch_internals, "options", options),
        patch.object(torch_internals, "called_directly", called_directly),
    ):
        learner, _, _, online = tuned(name, rounds)
        turn = tuning(learner, online)
        turn(1)  # compiles
    return Timed(left_out, lambda number: turn(number + 1))


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n", maxsplit=1)[0],
        epilog="'ms' is the median of all turns, '÷ all' the median of the ratios within a round.",
    )
    parser.add_argument("--rounds", type=int, default=12, help="turns of each (12)")
    parser.add_argument("--only", default="awac,td3bc", help="names, with commas between")
    arguments = parser.parse_args(argv)
    for name in arguments.only.split(","):
        if name not in sections():
            raise unknown("algorithm", name, sections())
    torch.set_num_threads(1)
    print(f"{'one update, without':<30}{'ms':>8}{'best':>8}{'÷ all':>9}  torch {torch.__version__}")
    for name in arguments.only.split(","):
        rows = [variant(name, left_out, arguments.rounds + 1) for left_out in WITHOUT]
        interleave(rows, arguments.rounds)
        say("")
        print(name)
        for row in rows:
            ratio = row.times_as_slow_as(rows[0])
            print(f"  {row.name:<28}{row.median:8.2f}{row.best:8.2f}{ratio:9.2f}", flush=True)
    return 0


if __name__ == "__main__":
    run_main(main)
