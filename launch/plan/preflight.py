"""What a start looks at before it makes anything; `--dry-run` looks at the same."""

from pathlib import Path

from otc_dist.datasets import store
from otc_dist.description import Description

from . import new_folder, run_record
from .keep import check_rewards
from .placement import Placement
from .plan import Plan


def check(plan: Plan, out: Path) -> None:
    """See that a run can begin in `out`, or this part of a run on several hosts go on there.

    Raises:
        UserError: those whom this machine meets refuse it, the folder is taken, held or cannot be
            made, the disk is too full, or the data cannot be had or are not what they should be.
    """
    plan.placement.check_access()
    if goes_on(plan):
        with run_record.locked(plan.folder):
            run_record.check_part(plan.folder, plan.description, plan.placement)
    else:
        new_folder.check_folder(out, plan.disk_bytes)
    _check_data(plan.description, plan.placement, plan.learners)


def goes_on(plan: Plan) -> bool:
    """Whether the folder holds a part of a run on several hosts, which the same command resumes."""
    return plan.placement.role != "all" and plan.folder.run_json.exists()


def _check_data(description: Description, placement: Placement, learners: tuple[str, ...]) -> None:
    """Raises UserError."""
    if not learners:
        return
    dataset = description.dataset
    there = store.check(dataset.name, dataset.transitions, learners)
    if there and placement.role == "all":
        check_rewards(description, learners)
