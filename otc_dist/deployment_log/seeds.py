"""Whether the episodes of a log have the seeds that its run's seed gives."""

from collections.abc import Iterable

import numpy as np

from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.record import Rows
from otc_dist.randomness import derive_seed
from otc_dist.transitions import Bool

# Behind a gap nobody knows how many episodes began in it: so many are tried for one that fits.
_MOST_EPISODES = 2**20
_NONE = -1  # a seed that no episode has


def foreign_steps(header: LogHeader, blocks: Iterable[Rows]) -> str | None:
    """How many steps of a log in the older form are of another deployment by their seeds.

    In words; None: there is none, or checksums vouch for them all.
    """
    if header.bound:
        return None
    check = SeedCheck(header)
    count = sum(int(check.wrong(rows).any(axis=1).sum()) for rows in blocks)
    return f"{count:,} of its steps have seeds of another deployment" if count else None


class SeedCheck:
    """Looks through the steps of a deployment in order, from any step on and over gaps."""

    def __init__(self, header: LogHeader) -> None:
        self._header = header
        self._of_seeds: list[dict[int, int]] = [{} for _ in range(header.copies)]  # -> number
        self._step = -1
        self._ended = np.ones(header.copies, np.bool_)
        # Of each copy's episode: its number, whether that is certain, and the seed that it has.
        self._numbers = np.full(header.copies, -1, np.int64)
        self._certain = np.ones(header.copies, np.bool_)
        self._seeds = np.full(header.copies, _NONE, np.int64)

    def wrong(self, rows: Rows) -> Bool:
        """(T, E): steps whose episode has another seed than its copy and number give.

        Behind a gap an episode may have any number that is possible there.
        """
        seeds, ends = rows["episode_seeds"], rows["terminated"] | rows["truncated"]
        found = np.zeros(seeds.shape, np.bool_)
        for t, step in enumerate(rows["step"].tolist()):
            if step != self._step + 1:
                self._certain[:], self._ended[:] = False, True
            for copy in np.flatnonzero(self._ended).tolist():
                self._begin(copy, int(seeds[t, copy]), step)
            found[t] = seeds[t] != self._seeds
            self._step, self._ended = step, ends[t].copy()
        return found

    def _begin(self, copy: int, seed: int, step: int) -> None:
        if self._certain[copy]:
            self._numbers[copy] += 1
            self._seeds[copy] = self._derived(copy, int(self._numbers[copy]))
            return
        of_seeds = self._of_seeds[copy]
        while seed not in of_seeds and len(of_seeds) <= min(step, _MOST_EPISODES):
            of_seeds[self._derived(copy, len(of_seeds))] = len(of_seeds)
        number = of_seeds.get(seed, _NONE)
        possible = number != _NONE and self._numbers[copy] <= number <= step
        self._certain[copy] = possible
        self._seeds[copy] = seed if possible else _NONE
        if possible:
            self._numbers[copy] = number

    def _derived(self, copy: int, number: int) -> int:
        header = self._header
        return derive_seed(header.seed, "deployment", header.deployment, copy, number)
