"""Write a run's `results.json` and `report.html`."""

import errno
import logging
from collections.abc import Mapping
from pathlib import Path

from otc_dist.report.results import results, to_json
from otc_dist.report.run_data import read_run
from otc_dist.report.run_page import render
from otc_dist.run.folder import RunFolder
from otc_dist.system import durable
from otc_dist.terminal.errors import UserError

log = logging.getLogger(__name__)

_NOT_OURS = (errno.EACCES, errno.EPERM, errno.EROFS)


def write_report(folder: RunFolder) -> Path:
    """Make both files from what the run folder holds so far; returns the page's path.

    Where one may look at the run but not write in it, they are made in the current folder, under
    the run's name.

    Raises:
        UserError: no run folder, or the files cannot be written.
    """
    run = read_run(folder)
    contents = {folder.results: to_json(results(run)), folder.report: render(run)}
    try:
        try:
            _write(contents)
            return folder.report
        except OSError as error:
            if error.errno not in _NOT_OURS:
                raise
        name = folder.root.resolve().name
        log.warning("%s cannot be written: its report is made here", folder.root)
        here = {path: Path(f"{name}-{path.name}").absolute() for path in contents}
        _write({here[path]: text for path, text in contents.items()})
        return here[folder.report]
    except OSError as error:
        raise UserError(f"{error.filename} cannot be written: {error.strerror}") from None


def _write(contents: Mapping[Path, str]) -> None:
    for path, text in contents.items():
        try:
            durable.write(path, text.encode())
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from None
