"""Write a run's `results.json` and `report.html`."""

from pathlib import Path

from otc_dist.errors import UserError
from otc_dist.report.results import results, to_json
from otc_dist.report.run_data import read_run
from otc_dist.report.run_page import render
from otc_dist.run_folder import RunFolder


def write_report(folder: RunFolder) -> Path:
    """Make both files from what the run folder holds so far; returns the page's path.

    Raises:
        UserError: no run folder, or the files cannot be written.
    """
    run = read_run(folder)
    for path, text in ((folder.results, to_json(results(run))), (folder.report, render(run))):
        partial = path.with_name(path.name + ".partial")
        try:
            partial.write_text(text, encoding="utf-8")
            partial.replace(path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise UserError(f"{path} cannot be written: {error.strerror}") from None
    return folder.report
