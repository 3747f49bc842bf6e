"""run.json while a launcher is at work: what it notes is written at once."""

from collections.abc import Iterable
from dataclasses import replace

from otc_dist.datasets import inputs
from otc_dist.description import Description
from otc_dist.run.folder import RunFolder

from .run_record import RunRecord, State


class Ledger:
    """The record of a run, as it stands on the disk.

    Every method raises OSError if it cannot be written.
    """

    def __init__(self, record: RunRecord, folder: RunFolder) -> None:
        self.record, self._folder = record, folder

    def enter(self, state: State) -> None:
        """Note where the run stands."""
        self.record = self.record.moved_to(state, self._folder)

    def note_inputs(self, found: inputs.Digests, description: Description) -> None:
        """Note what was not noted yet of what the run reads.

        Raises:
            UserError: an input is another one than was noted.
        """
        inputs.check(self.record.inputs, found, description)
        self._change(replace(self.record, inputs={**found, **self.record.inputs}))

    def note_libraries(self, paths: Iterable[str]) -> None:
        """Note by which libraries its processes compute."""
        found = tuple(sorted({*self.record.libraries, *paths}))
        self._change(replace(self.record, libraries=found))

    def _change(self, record: RunRecord) -> None:
        if record != self.record:
            record.write(self._folder)
            self.record = record
