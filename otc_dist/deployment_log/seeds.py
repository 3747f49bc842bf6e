"""Whether the episodes of a log have the seeds that its run's seed gives."""

from collections.abc import Iterable, Iterator

import numpy as np

from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.record import Rows
from otc_dist.randomness import derive_seed
from otc_dist.transitions import Bool

# Behind a gap nobody knows how many episodes began in it: so many are tried for one that fits.
_MOST_EPISODES = 2**20
_NONE = -1  # a seed that no episode has


class OwnSteps:
    """Leaves out of a log in the older form what is of another deployment by its seeds.

    `left_out` counts these steps. Of other logs all steps are own: their checksums say so.
    """

    def __init__(self, header: LogHeader) -> None:
        self._header, self._layout = header, header.layout()
        self.left_out = 0

    def of(self, blocks: Iterable[Rows]) -> Iterator[Rows]:
        """The own steps of blocks that are in order."""
        self.left_out = 0
        check = SeedCheck(self._header)
        for rows in blocks:
            if self._header.bound:
                yield rows
                continue
            own = ~check.wrong(rows).any(axis=1)
            self.left_out += int((~own).sum())
            if own.any():
                # By bytes: NumPy need not copy those between the fields.
                records = np.frombuffer(rows.tobytes(), np.uint8).reshape(len(rows), -1)
                yield self._layout.rows(records[own].tobytes())

    @property
    def in_words(self) -> str | None:
        """What was left out, in words; None: nothing."""
        if not self.left_out:
            return None
        return f"left out: {self.left_out:,} steps with seeds of another deployment"


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

        After a gap, and after wrong ones, an episode may have any number that is possible there.
        """
        seeds, ends = rows["episode_seeds"], rows["terminated"] | rows["truncated"]
        found = np.zeros(seeds.shape, np.bool_)
        for t, step in enumerate(rows["step"].tolist()):
            if step != self._step + 1:
                self._certain[:] = False
            for copy in np.flatnonzero(self._ended | ~self._certain).tolist():
                self._expect(copy, int(seeds[t, copy]), step)
            found[t] = seeds[t] != self._seeds
            self._certain &= ~found[t]
            self._step, self._ended = step, ends[t].copy()
        return found

    def _expect(self, copy: int, seed: int, step: int) -> None:
        """Settle which seed a copy's episode must have; _NONE: not the one that it has."""
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
