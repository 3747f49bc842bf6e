"""`launch chaos`: break runs in every way, and compare what they end with to an undisturbed run."""

import argparse
import random
import shutil
import statistics
import sys
import tempfile
import textwrap
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from otc_dist.terminal.errors import UserError, unknown
from otc_dist.terminal.parser import Parser

from ..plan.new_folder import NewFolder
from . import sandbox
from .disturbed_run import PHASES, DisturbedRun, StuckError
from .fault import Fault, MissedError, Setup
from .faults import FAULTS
from .outcome import differences, outcome

# The smallest run with every phase, each long enough to be hit.
SHORT_RUN = (
    *("cooperative_navigation", "--set", "env.agents=2", "--set", "algorithm.name=td3bc"),
    *("--set", "algorithm.hidden=[32,32]", "--set", "algorithm.batch_size=32"),
    *("--set", "dataset.transitions=1500", "--set", "engine.name=eager"),
    *("--set", "embedding.updates=300", "--set", "offline.updates=600"),
    *("--set", "sampling.candidates=64", "--set", "sampling.references=64"),
    *("--set", "sampling.similarity_sample=500", "--set", "deployment.count=3"),
    *("--set", "deployment.transitions=2000", "--set", "deployment.updates=300"),
    *("--set", "evaluation.episodes=4", "--set", "bus.answer_deadline=60.0"),
)
IN_VAIN = 3  # runs in a row that a fault has found nothing to strike in
AIM = 20.0  # seconds that a fault waits for the phase in which it is to strike
SCATTER = 0.7  # seconds within which it then strikes, at random
# The same for phases that last a second or two, and for one that lasts far longer.
SCATTERS = {"data": 0.3, "start": 0.3, "report": 0.3, "compile": 8.0}
SELDOM = {"kill-preparation": 20, "kill-compiler": 5}  # each takes a run of its own
WHOLE = {name: 100 if name.startswith("kill-") else 20 for name in FAULTS if name != "any"} | SELDOM

_EXPLANATION = """\
Runs one short run undisturbed, and then as many as it takes for the faults that are asked for,
each at a random time. What dies is started again by its launcher; a launcher that is killed, or
that ends because the disk is full, is resumed; one that ends by itself has failed. In the end every
run must have left the same files as the undisturbed one, with the same weights, log payloads,
returns, metrics, results and report, to the byte, but for names and times. A fault that was asked
for and found nothing to strike has failed too.
"""


@dataclass
class Tally:
    """What came of one kind of fault."""

    wanted: int
    struck: int = 0
    runs: int = 0
    wrong: list[str] = field(default_factory=list)
    phases: Counter[str] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)  # from a fault until all are up again
    skipped: str = ""
    in_vain: int = 0  # runs in a row, until now, in which there was nothing to strike


def main(argv: list[str]) -> int:
    """Returns 0 if every run ended as the undisturbed one, and every fault struck that can be had.

    Raises:
        UserError: an unknown fault, or no folder can be made at --out, or one is there that is not
            empty.
    """
    arguments = command_line().parse_args(argv)
    wanted = _wanted(arguments.faults)
    sandbox.enter()
    out: Path = (arguments.out or Path(tempfile.mkdtemp(prefix="otc-chaos-"))).resolve()
    NewFolder(out)  # a mistake shows at once
    if any(out.iterdir()):
        raise UserError(f"{out} is not empty: use another --out")
    start = time.monotonic()
    with sandbox.prepared(out) as prepared:
        setup = Setup(out, prepared)
        undisturbed = _UndisturbedRuns(out)
        tallies: dict[str, Tally] = {}
        try:
            for name, count in wanted.items():
                tallies[name] = Tally(count)
                _inflict(name, setup, arguments.seed, undisturbed, tallies[name])
        finally:  # also after Ctrl-C: what was found so far
            print(f"\n{(time.monotonic() - start) / 60:.0f} min, seed {arguments.seed}")
            print("\n".join(_table(tallies)))
    wrong = any(tally.wrong or tally.in_vain for tally in tallies.values())
    if not wrong and arguments.out is None:
        shutil.rmtree(out)
    return int(wrong)


class _UndisturbedRuns:
    """What undisturbed runs leave, each run when it is first asked for."""

    def __init__(self, out: Path) -> None:
        self._out, self._known = out, dict[tuple[str, ...], dict[str, bytes]]()

    def outcome(self, changes: tuple[str, ...]) -> Mapping[str, bytes]:
        """Of the run with these flags.

        Raises:
            UserError: it does not come to its end.
        """
        if changes not in self._known:
            print(
                f"{self._out}: an undisturbed run{'' if changes == () else ' more'} ...", flush=True
            )
            root = self._out / f"undisturbed-{len(self._known)}"
            try:
                with DisturbedRun(root, (*SHORT_RUN, *changes)) as run:
                    run.start()
                    run.finish()
            except StuckError as error:
                raise UserError(f"{root}: undisturbed, and yet: {error}") from None
            self._known[changes] = outcome(run.folder)
        return self._known[changes]


def _inflict(
    name: str, setup: Setup, seed: int, undisturbed: _UndisturbedRuns, tally: Tally
) -> None:
    """Strike as often as it is wanted, in as many runs as it takes."""
    make = FAULTS[name]
    tally.skipped = make(setup).impossible
    expected = {} if tally.skipped else undisturbed.outcome(make(setup).changes)
    while not tally.skipped and tally.struck < tally.wanted and len(tally.wrong) < 3:
        if tally.in_vain == IN_VAIN:
            print(f"{name}: nothing to strike in {IN_VAIN} runs", file=sys.stderr, flush=True)
            return
        fault, before = make(setup), tally.struck
        numbers = random.Random(f"{seed} {name} {tally.runs}")
        folder = setup.folder_for(fault) / f"{name.rstrip('%')}-{tally.runs:03d}"
        run = DisturbedRun(folder, (*SHORT_RUN, *fault.flags, *fault.changes), fault.forgiving)
        try:
            with run, fault:
                _one_run(run, fault, numbers, tally)
            wrong = differences(outcome(run.folder), expected)
        except (StuckError, OSError, UserError, ValueError) as error:
            wrong = [f"{type(error).__name__}: {error}"]
        tally.runs += 1
        tally.in_vain = 0 if tally.struck > before else tally.in_vain + 1
        if wrong:
            tally.wrong.append(f"{folder}: {', '.join(wrong)}")
            print(f"WRONG: {tally.wrong[-1]}", file=sys.stderr, flush=True)
            _keep(folder, setup.out / "wrong" / folder.name)
        else:
            shutil.rmtree(folder)
        print(f"{name}: {tally.struck} of {tally.wanted}, {tally.runs} runs", flush=True)


def _one_run(run: DisturbedRun, fault: Fault, numbers: random.Random, tally: Tally) -> None:
    run.start()
    while not run.over:
        ahead = [phase for phase in run.phases_ahead if phase in fault.phases]
        if tally.struck >= tally.wanted or not ahead:
            run.finish()
            return
        rarest = min(tally.phases[phase] for phase in ahead)
        aim = numbers.choice([phase for phase in ahead if tally.phases[phase] == rarest])
        if not run.wait_for_phase(aim, AIM):
            return
        if not run.wait(numbers.uniform(0.0, SCATTERS.get(aim, SCATTER))):
            return
        if (phase := run.phase) not in fault.phases:
            continue
        try:
            struck = time.monotonic()
            fault.strike(run, numbers)
        except MissedError:
            run.wait(SCATTER)
            continue
        tally.struck += 1
        tally.phases[phase] += 1
        if run.settle():
            tally.seconds.append(time.monotonic() - struck)


def _keep(folder: Path, where: Path) -> None:
    if folder.exists():
        shutil.copytree(folder, where, dirs_exist_ok=True)
        shutil.rmtree(folder)


def _table(tallies: Mapping[str, Tally]) -> list[str]:
    row = "{:18} {:>6} {:>5} {:>9} " + " {:>9}" * len(PHASES) + "  {:>9}"
    lines = [row.format("fault", "struck", "runs", "identical", *PHASES, "back in s")]
    for name, tally in tallies.items():
        if tally.skipped:
            lines.append(f"{name:18} skipped: {tally.skipped}")
            continue
        back = f"{statistics.median(tally.seconds):.1f}" if tally.seconds else ""
        same = f"{tally.runs - len(tally.wrong)}"
        where = [tally.phases[phase] for phase in PHASES]
        struck = f"{tally.struck} of {tally.wanted}" if tally.in_vain else f"{tally.struck}"
        lines.append(row.format(name, struck, tally.runs, same, *where, back))
    return lines


def _wanted(given: list[str]) -> dict[str, int]:
    """From `kill-host=100` to how often; nothing given: the whole table."""
    wanted = dict[str, int]()
    for text in given:
        name, _, count = text.partition("=")
        if name not in FAULTS:
            raise unknown("fault", name, FAULTS)
        if not count.isdecimal() or not int(count):
            raise UserError(f"how often? write it as {name}=20")
        if name in wanted:
            raise UserError(f"{name} is given twice: how often?")
        wanted[name] = int(count)
    return wanted or WHOLE


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.launch chaos",
        description=_EXPLANATION,
        epilog=textwrap.fill(f"faults: {', '.join(FAULTS)}", 96, break_on_hyphens=False),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "faults", nargs="*", metavar="FAULT=COUNT", help="as kill-host=100 (default: all)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of what strikes when (default: 0)")
    parser.add_argument("--out", type=Path, help="folder of the runs (default: a temporary one)")
    return parser
