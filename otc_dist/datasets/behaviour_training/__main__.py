"""The command `python -m otc_dist.datasets.behaviour_training TASK`."""

from pathlib import Path

import torch

from otc_dist.datasets.behaviour_training.training import TASKS, train, write
from otc_dist.terminal.errors import run_main
from otc_dist.terminal.parser import Parser


def main(argv: list[str]) -> int:
    """Command line."""
    parser = Parser(
        prog="python -m otc_dist.datasets.behaviour_training",
        description="Train a task's behaviour policies with PPO (some minutes, one thread).",
    )
    parser.add_argument("task", choices=sorted(TASKS))
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(__file__).parents[1] / "snapshots",
        help="folder of the snapshots (default: the package's own)",
    )
    options = parser.parse_args(argv)
    torch.set_num_threads(1)
    write(options.task, options.seed, train(options.task, options.seed), options.out)
    return 0


if __name__ == "__main__":
    run_main(main)
