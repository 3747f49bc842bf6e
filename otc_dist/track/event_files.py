"""TensorBoard: one folder of event files for each agent and for the team, by torch's writer."""

from collections.abc import Mapping
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

from otc_dist.terminal.errors import UserError
from otc_dist.track.points import TEAM
from otc_dist.track.trackers import About

_OURS = ".otc_dist"  # how the names of our files end; no other is touched
_WHOSE = ".otc_dist.run"  # says of which run they are


class EventFiles:
    """Written anew each time, since event files cannot be changed and the run has all of it.

    A TensorBoard that shows them meanwhile is told to forget what it has read.
    """

    def __init__(self, folder: Path, about: About) -> None:
        self._folder = folder
        self._writers: dict[str, SummaryWriter] = {}
        whose = folder / _WHOSE
        if whose.exists() and whose.read_text(encoding="utf-8") != about.identity:
            raise UserError(f"{folder} holds another run, which would be lost: use another --out")
        whose.write_text(about.identity, encoding="utf-8")
        for path in folder.glob(f"*/events.out.tfevents.*{_OURS}"):
            path.unlink()
        results = dict.fromkeys(about.results, 0.0)  # by their names; the values are not written
        every = hparams(dict(about.settings), results)  # type: ignore[no-untyped-call]
        writer = self._writer(TEAM)._get_file_writer()  # type: ignore[no-untyped-call]
        for summary in every:
            writer.add_summary(summary)

    def _writer(self, source: str) -> SummaryWriter:
        if source not in self._writers:
            self._writers[source] = SummaryWriter(
                str(self._folder / source), purge_step=0, filename_suffix=_OURS
            )
        return self._writers[source]

    def log(self, source: str, step: int, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            self._writer(source).add_scalar(name, value, step)

    def flush(self) -> None:
        for writer in self._writers.values():
            writer.flush()

    def close(self) -> None:
        for writer in self._writers.values():
            writer.close()


def open_tracker(folder: Path, about: About) -> EventFiles:
    """As `trackers.open_tracker`."""
    return EventFiles(folder, about)
