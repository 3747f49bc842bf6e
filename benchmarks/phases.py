"""Where did a finished run spend its time?

    python benchmarks/phases.py runs/3agent_hopper-seed0

By when its files were written, so of a run that was never interrupted. Nothing runs beside
anything else but the data beside the compiling, and the learners beside each other; "waited for"
is what the first of them to finish waited for the last.
"""

import argparse
import json
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

from otc_dist.description import Description
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError, run_main

PREPARED = {"data": "data", "compiling": "compile"}  # what is printed last, by whom


def written(paths: Iterable[Path]) -> list[float]:
    """When each was, in order. Raises UserError: one is not there."""
    try:
        return sorted(path.stat().st_mtime for path in paths)
    except OSError as error:
        raise UserError(f"{error.filename}: {error.strerror}; is the run finished?") from None


def phases(folder: RunFolder) -> tuple[dict[str, float], dict[str, float]]:
    """Seconds by phase, and those that the first learner waited for the last."""
    description = Description.load(folder.description)
    began = datetime.fromisoformat(json.loads(folder.run_json.read_text())["started"]).timestamp()
    agents = sorted(path.name for path in (folder.root / "agents").iterdir())
    seconds = dict.fromkeys((*PREPARED, "offline", "evaluation", "acting", "tuning", "report"), 0.0)
    waited = dict.fromkeys(("offline", "tuning"), 0.0)
    for name, process in PREPARED.items():
        output = folder.output(process)
        if output.exists() and output.stat().st_size:
            seconds[name] = output.stat().st_mtime - began
    (now,) = written([folder.dataset_card])
    for k in range(description.deployment.count + 1):
        phase = "tuning" if k else "offline"
        if k:
            (log,) = written([folder.deployment(k)])
            seconds["acting"] += log - now
            now = log
        ends = written(folder.checkpoint(agent, k) for agent in agents)
        seconds[phase] += ends[-1] - now
        waited[phase] += ends[-1] - ends[0]
        (evaluated,) = written([folder.evaluation(k)])
        seconds["evaluation"] += evaluated - ends[-1]
        now = evaluated
    (reported,) = written([folder.report])
    seconds["report"] = reported - now
    return {**seconds, "all": reported - began}, waited


def table(seconds: dict[str, float], waited: dict[str, float]) -> str:
    lines = [f"{'phase':<12}{'s':>8}{'of all':>8}{'waited for':>12}"]
    for phase, took in seconds.items():
        waiting = f"{waited[phase]:12.1f}" if phase in waited else ""
        lines.append(f"{phase:<12}{took:8.1f}{took / seconds['all']:8.0%}{waiting}")
    return "\n".join(lines)


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("run", type=Path, help="its folder")
    print(table(*phases(RunFolder(parser.parse_args(argv).run))))
    return 0


if __name__ == "__main__":
    run_main(main)
