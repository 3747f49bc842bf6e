"""Fixes what a description leaves open, so that a run depends on nothing but its description."""

import math
import subprocess
import sys
import time
from functools import cache

from otc_dist.datasets.names import DatasetName
from otc_dist.description import Description
from otc_dist.description.algorithms import check_fit
from otc_dist.description.sections import EngineSection
from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError

from ..plan.keep import settled
from ..supervise.standstill import Standstill
from ..supervise.supervisor import die_with_parent

_LOOK = 0.5  # seconds between two looks at the process that was asked

# In a process of its own: importing torch takes seconds and memory that the launcher never needs.
_ASK_ENGINE = """
import sys
from otc_dist.steps import engine
from otc_dist.terminal.errors import run_main
from otc_dist.description.sections import EngineSection
asked = lambda text: EngineSection.model_validate_json(text)
run_main(lambda argv: print(engine.resolve(asked(argv[0]), int(argv[1])).model_dump_json()) or 0)
"""


def resolve(description: Description, data_here: bool = True) -> Description:
    """A copy with dataset.transitions, M, L and what is kept (deployment.*), and engine.* fixed.

    M is rounded up to a multiple of env.copies, since every copy contributes equally.

    Args:
        data_here: whether somebody learns on this machine; if not, an imported data set need not
            be here.

    Raises:
        UserError: an unknown environment or data set, a data set of another environment, an
            algorithm that does not fit its agents, deployments that cannot be compared though
            that is asked for, or an engine that this machine cannot run.
    """
    task = registry.task(description.env.id)
    for agent in registry.team_spec(description.env.id).agents:
        check_fit(description.algorithm, agent, task)
    name, transitions = description.dataset.name, description.dataset.transitions
    if name.rpartition("/")[0] != description.env.id:
        raise UserError(
            f"the data set {name} is not of the environment {description.env.id}: change one"
        )
    if data_here or not transitions:
        usual = _usual_size(name, data_here)
        transitions = transitions or usual
    copies = description.env.copies
    wanted = description.deployment.transitions or description.deployment.fraction * transitions
    deployed = math.ceil(max(wanted, 1) / copies) * copies
    fixed = description.with_assignments(
        f"dataset.transitions={transitions}",
        f"deployment.transitions={deployed}",
        f"deployment.updates={tuning_updates(description)}",
    )
    engine = _engine(fixed)
    return settled(fixed).with_assignments(
        f"engine.name={engine.name}", f"engine.products={engine.products}"
    )


def _usual_size(name: str, data_here: bool) -> int:
    try:
        return DatasetName.parse(name).usual_size()
    except UserError:
        if data_here:
            raise
        raise UserError(
            f"{name} is not on this machine: give its size, --set dataset.transitions=N"
        ) from None


def tuning_updates(description: Description) -> int:
    """L: as described, or the algorithm's of Table 3."""
    return description.deployment.updates or description.algorithm.tuning_updates


def total_updates(description: Description) -> int:
    """Updates of one agent's base algorithm in the whole run."""
    return (
        description.offline.updates + description.deployment.count * description.deployment.updates
    )


def _engine(description: Description) -> EngineSection:
    asked_for = description.engine
    if asked_for.name == "eager":  # runs everywhere
        return EngineSection(name="eager", products="torch")
    asked = asked_for.model_dump_json()
    return _chosen(asked, total_updates(description), description.bus.answer_deadline)


@cache  # a campaign's parts are alike
def _chosen(asked_for: str, updates: int, patience: float) -> EngineSection:
    """What this machine chooses for an engine section, as JSON, and that many updates.

    Raises:
        UserError: it cannot run that, or does not answer.
    """
    with subprocess.Popen(
        [sys.executable, "-c", _ASK_ENGINE, asked_for, str(updates)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,
        preexec_fn=die_with_parent(),
    ) as asked:
        try:
            chosen, errors = _heard(asked, patience)
        finally:
            asked.kill()
    if asked.returncode != 0:
        lines = errors.strip().splitlines() or ["no output"]
        raise UserError(f"cannot choose an engine: {lines[-1].removeprefix('error: ')}")
    if errors.strip():  # what this torch lacks
        print(errors.strip(), file=sys.stderr)
    return EngineSection.model_validate_json(chosen)


def _heard(asked: "subprocess.Popen[str]", patience: float) -> tuple[str, str]:
    """What a process printed to its end. Raises UserError if it stands still before."""
    standstill = Standstill(asked.pid, patience)
    while True:
        try:
            return asked.communicate(timeout=_LOOK)
        except subprocess.TimeoutExpired:
            if why := standstill.look(time.monotonic()):
                raise UserError(
                    f"cannot choose an engine: the process that was asked {why}; try again, or"
                    " choose one: --set engine.name=eager"
                ) from None
