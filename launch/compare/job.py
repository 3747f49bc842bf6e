"""`python -m otc_dist.launch.compare.job FOLDER SEEDS OUTPUT PIECE ...`: one process.

compile MARK                     compile what offline training runs, and make the file MARK
offline AGENT [ASSIGNMENT ...]   train pi_0 of one agent, or of an arm that has its own; alone
                                 this is done for several seeds
pi_0 [ASSIGNMENT ...]            evaluate the team pi_0
arm NAME ASSIGNMENT ...          tune and evaluate an arm

What it took is written beside OUTPUT, unless an earlier process has done a part of it; of several
seeds each one's share where it would print alone.
"""

from pathlib import Path

import torch

from otc_dist.comparison import arms, runs, spent
from otc_dist.comparison.mechanism import check
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.comparison.spent import Spent
from otc_dist.description import Description, user_code
from otc_dist.description.distances import DISTANCES
from otc_dist.terminal.errors import run_main

from ..plan.run_record import versions
from ..run.compile import compile_updates
from ..supervise.jobs import ProgressLines


def main(argv: list[str]) -> int:
    """Do one piece."""
    torch.set_num_threads(1)
    path, seeds, output, piece, *rest = argv
    folder = ComparisonFolder(Path(path))
    base = Description.load(folder.description).trusted()
    arms.trust(rest)
    every = arms.parse_seeds(seeds)
    with user_code.answers_for(*base.parts, *(text.partition("=")[2] for text in rest)):
        whole = _do(folder, base, every, piece, rest)
    if whole:
        name = folder.job(Path(output))
        each = [folder.output(seed, name) for seed in every] if len(every) > 1 else [Path(output)]
        share = Spent.so_far(len(each))
        for alone in each:
            share.write(spent.beside(alone))
    return 0


def _do(
    folder: ComparisonFolder,
    base: Description,
    seeds: tuple[int, ...],
    piece: str,
    rest: list[str],
) -> bool:
    """Returns whether this process has done all of it."""
    seed = seeds[0]
    if piece == "compile":
        compile_updates(base, fits=DISTANCES)
        Path(rest[0]).touch()
    elif piece == "offline":
        return runs.train_offline(folder, base, seeds, rest[0], ProgressLines(), rest[1:])
    elif piece == "pi_0":
        runs.evaluate_offline(folder, base, seed, rest)
    else:
        name, *assignments = rest
        if piece == "arm":
            runs.run_arm(folder, base, seed, name, assignments, versions(), ProgressLines())
        else:
            analysed = base.with_assignments(*assignments)
            check.measure(folder, analysed, seed, name, ProgressLines())
    return True


if __name__ == "__main__":
    run_main(main)
