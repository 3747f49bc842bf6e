"""The arrays of a team that a vault holds, by agent: stacked and filled up, or one an agent.

    observations (streams, rows, N, widest)      or  observations.AGENT (streams, rows, size)
    rewards      (streams, rows, N)              or  rewards.AGENT      (streams, rows)

Streams follow one another here: of S streams of T rows, a row is the (s T + t)-th.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.datasets.recording import flags, numbers
from otc_dist.datasets.vault import Vault
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32

_Arrays = Sequence[NDArray[Any]]  # N x (S T, size)


class Fields:
    """The arrays of `vault` as those of a team."""

    def __init__(self, vault: Vault, team: TeamSpec) -> None:
        self._vault, self._agents = vault, team.names
        self.source = str(vault.folder)
        self.rows = vault.rows  # T
        self._streams = 0  # S, known once an array was read
        self.taken: set[str] = set()  # the names of the arrays that were read

    def has(self, field: str) -> bool:
        """Whether there is such an array, of the team or of its agents."""
        return any(name == field or name.startswith(f"{field}.") for name in self._vault.names)

    def vectors(
        self, field: str, *choices: Sequence[int], filled: bool = True
    ) -> tuple[Float32, ...]:
        """N x (S T, size), of the first of several `choices` of sizes that the array has.

        Args:
            field: its name, as "infos.legals".
            choices: sizes by agent. Stacked vectors are as wide as the widest of them.
            filled: whether what follows after a narrower one must be zeros, as OG-MARL fills it up.

        Raises:
            UserError: there is no such array, it has other agents or sizes, or bad values.
        """
        found, stacked = self._read(field)
        widths = [array.shape[1] for array in found]
        for sizes in choices:
            if widths == ([max(sizes)] * len(sizes) if stacked else list(sizes)):
                break
        else:
            wanted = " or ".join(str(max(sizes) if stacked else list(sizes)) for sizes in choices)
            given = widths[0] if stacked else widths
            raise UserError(f"{self.source}: {field} are {given} numbers wide, not {wanted}")
        made = []
        for agent, array, size in zip(self._agents, found, sizes, strict=True):
            if filled and array[:, size:].any():
                raise UserError(f"{self.source}: {field} of {agent} are more than {size} numbers")
            name, array = (
                f"{field} of {agent}",
                array.astype(np.uint8) if array.dtype == np.bool_ else array,
            )
            made.append(numbers(array[:, :size], name, (-1, size), self.source))
        return tuple(made)

    def numbers(self, field: str) -> tuple[Float32, ...]:
        """N x (S T,), one number a step of each agent; errors as `vectors`."""
        return tuple(array[:, 0] for array in self.vectors(field, [1] * len(self._agents)))

    def flags(self, field: str) -> tuple[Bool, ...]:
        """N x (S T,), 0 or 1 at each step of each agent; errors as `vectors`."""
        found, _ = self._read(field)
        rows = len(found[0])
        return tuple(
            flags(array, f"{field} of {agent}", rows, self.source)
            for agent, array in zip(self._agents, found, strict=True)
        )

    def shared(self, field: str) -> NDArray[Any] | None:
        """(S T,), one number a step of all agents, or None if there is no such array."""
        found = self._vault.array(field)
        if found is None:
            return None
        rows = self._rows(found, field)
        if rows.size != len(rows):
            raise UserError(
                f"{self.source}: {field} has shape {found.shape}: not one number a step"
            )
        return rows.reshape(-1)

    def _read(self, field: str) -> tuple[_Arrays, bool]:
        """N x (S T, size), and whether they were stacked."""
        stacked = self._vault.array(field)
        if stacked is not None:
            rows = self._rows(stacked, field)
            if rows.ndim == 2:  # one number an agent
                rows = rows[:, :, np.newaxis]
            if rows.ndim != 3 or rows.shape[1] != len(self._agents):
                raise UserError(
                    f"{self.source}: {field} has shape {stacked.shape}, and"
                    f" {len(self._agents)} agents of vectors are wanted"
                )
            return [rows[:, i] for i in range(len(self._agents))], True
        found = []
        for agent in self._agents:
            own = self._vault.array(f"{field}.{agent}")
            if own is None:
                which = f"{field} of {agent}" if self.has(field) else field
                raise UserError(f"{self.source} has no {which}")
            rows = self._rows(own, f"{field}.{agent}")
            if rows.ndim > 2:
                raise UserError(f"{self.source}: {field}.{agent} has shape {own.shape}: no vectors")
            found.append(rows.reshape(len(rows), -1))
        return found, False

    def _rows(self, array: NDArray[Any], name: str) -> NDArray[Any]:
        self.taken.add(name)
        self._streams = self._streams or array.shape[0]
        if array.shape[0] != self._streams or not array.size:
            raise UserError(
                f"{self.source}: {name} has shape {array.shape}: no {self._streams} streams"
            )
        return array.reshape(-1, *array.shape[2:])
