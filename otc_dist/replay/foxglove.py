"""`--foxglove OUT.mcap`: what Foxglove shows of logs, unfinished ones too, with alpha and 𝔻.

A finished log has most of it already (`deployment_log.foxglove`). alpha and 𝔻 it cannot have: the
learners work them out after the deployment, each for itself. They are taken from the run folder
that the logs lie in, if they do: with a deployment's first step those by which the policies that
act in it were tuned, with its last step those that came of it.
"""

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from mcap.writer import CompressionType, Writer

import otc_dist
from otc_dist.deployment_log.format import CHUNK_SIZE
from otc_dist.deployment_log.foxglove import FoxgloveChannels
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import summarise
from otc_dist.deployment_log.several import in_order
from otc_dist.replay.output import claimed, note_shortfall
from otc_dist.replay.selection import Selection, select
from otc_dist.report.run_data import Tuning, read_run
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import say
from otc_dist.terminal.progress import Report, shown

Tunings = dict[str, dict[int, Tuning]]  # agent -> deployment


def run(arguments: argparse.Namespace) -> int:
    """Write what Foxglove shows of all files, in order, and say where it is."""
    out = Path(arguments.foxglove)
    with ExitStack() as stack:
        logs = {path: stack.enter_context(OpenLog(path)) for path in arguments.files}
        ordered = [logs[path] for path in in_order({p: log.header for p, log in logs.items()})]
        summaries = [summarise(log) for log in ordered]
        for summary in summaries:
            note_shortfall(summary)
        selections = [select(arguments, summary) for summary in summaries]
        with (
            claimed(out, force=arguments.force, reads=arguments.files) as path,
            path.open("wb") as stream,
            shown(out.name, "steps") as report,
        ):
            writer = Writer(stream, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
            writer.start("", f"otc_dist {otc_dist.__version__}")
            _write(writer, ordered, selections, report)
            writer.finish()  # type: ignore[no-untyped-call]
    say(out)
    return 0


def _write(
    writer: Writer, logs: Sequence[OpenLog], selections: Sequence[Selection], report: Report
) -> None:
    channels = FoxgloveChannels(writer, logs[0].header, selections[0].copy or 0)
    done, total = 0, sum(part.stop - part.start for part in selections)
    for log, part in zip(logs, selections, strict=True):
        tunings, deployment = _tunings_beside(log.path), log.header.deployment
        time = None
        for rows in log.blocks(part.start, part.stop):
            if time is None:
                _write_tunings(channels, tunings, deployment - 1, int(rows[0]["log_time"]))
            channels.write(rows)
            time = int(rows[-1]["log_time"])
            done += len(rows)
            report(done, total)
        if time is not None:
            _write_tunings(channels, tunings, deployment, time)


def _write_tunings(
    channels: FoxgloveChannels, tunings: Tunings, deployment: int, log_time: int
) -> None:
    for agent, by_deployment in tunings.items():
        sampler_metrics = (
            by_deployment[deployment].sampler_metrics if deployment in by_deployment else {}
        )
        if (
            "alpha" in sampler_metrics and "similarity" in sampler_metrics
        ):  # only acceptance by rank has them
            channels.write_tuning(
                agent, log_time, deployment, sampler_metrics["alpha"], sampler_metrics["similarity"]
            )


def _tunings_beside(path: Path) -> Tunings:
    """What the learners noted in the run folder that a log lies in; nothing if it is none."""
    folder = RunFolder(path.resolve().parent.parent)
    try:
        return {agent.name: agent.tunings for agent in read_run(folder).agents}
    except UserError:
        return {}
