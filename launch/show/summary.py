"""The last lines of a finished run: what happened, good or bad, and where the report is."""

import json
import sys
from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import Console

from otc_dist.report.kept import went_back
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.amounts import plus_minus
from otc_dist.terminal.printable import printable, say

_STYLES = {"good": "bold green", "bad": "bold red"}  # by the verdict's tone


def show_summary(folder: RunFolder) -> None:
    """Print the lines; on a terminal the first is coloured by whether it is good or bad."""
    tone = _read(folder)["verdict"]["tone"]
    first, *others = summary_lines(folder)
    console = Console(force_terminal=sys.stdout.isatty(), highlight=False, soft_wrap=True)
    console.print(printable(first), style=_STYLES.get(tone, "bold"), markup=False)
    say(*others)


def summary_lines(folder: RunFolder) -> Iterator[str]:
    """From results.json, which the report has just written."""
    results = _read(folder)
    label = f" ({results['label']})" if results["label"] else ""
    yield results["verdict"]["sentence"]
    yield from results["verdict"]["more"]
    yield f"{results['name']}{label}: finished"
    table: list[Mapping[str, Any]] = results["table"]
    if table:
        offline, last = table[0], table[-1]
        yield f"return, mean of {offline['returns']['count']} greedy episodes: " + _change(
            offline["returns"]["mean"], last["returns"]["mean"], last["deployment"]
        )
        if offline["score"] is not None and last["score"] is not None:
            yield "normalised score: " + _change(
                offline["score"], last["score"], last["deployment"]
            )
        if offline["success"] is not None and last["success"] is not None:
            yield "episodes won, %: " + _change(
                offline["success"], last["success"], last["deployment"]
            )
    if back := went_back((row["deployment"], row["reverted_to"]) for row in results["measured"]):
        yield back
    if results["stopped"] is not None:
        yield f"no more deployments: {results['stopped']['reason']}"
    if results["recommended"] is not None:
        yield _recommended(results["recommended"])
    yield f"report: {folder.report}"


def _read(folder: RunFolder) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(folder.results.read_text(encoding="utf-8"))
    return found


def _recommended(recommended: Mapping[str, Any]) -> str:
    checkpoint = f"agents/*/checkpoint_{recommended['policy']:02d}.safetensors"
    if recommended["deployment"] is None:
        return f"recommended: the last tuned policy ({checkpoint}), which was not deployed"
    line = f"recommended: the policy of deployment {recommended['deployment']} ({checkpoint})"
    if recommended["mean"] is None:
        return line
    return (
        f"{line}, measured {plus_minus(recommended['mean'], recommended['error'])} over the first"
        f" {recommended['horizon']} steps of {recommended['episodes']} episodes"
    )


def _change(offline: float, last: float, deployments: int) -> str:
    if deployments == 0:
        return f"offline {offline:.1f}"
    return f"offline {offline:.1f}, after deployment {deployments} {last:.1f}"
