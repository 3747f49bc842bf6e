"""What uniform sampling made of the same offline policies, where a run beside this one says so."""

from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, FiniteFloat, ValidationError

from otc_dist.description import Description
from otc_dist.description.kinds import STRATEGIES
from otc_dist.otc.samplers.uniform import UniformSection
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError


@dataclass(frozen=True)
class Uniform:
    """The reference: its run's folder, and the greedy return of the policy that it recommends."""

    folder: str
    policy: int  # k of pi_k
    greedy_return: float


class _Recommended(BaseModel):
    policy: int
    greedy_return: FiniteFloat | None


class _Results(BaseModel):
    """What is needed of a results.json."""

    complete: bool
    recommended: _Recommended | None


def find(folder: RunFolder, description: Description) -> Uniform | None:
    """Of the folders beside `folder` the first complete run of the same description and seed but
    with uniform sampling. What cannot be read there is passed over: it is not this run's.
    """
    if _plain(description):
        return None
    wanted = _apart_from_sampling(description)
    try:
        beside = sorted(path for path in folder.root.resolve().parent.iterdir() if path.is_dir())
    except OSError:
        return None
    found = (_read(RunFolder(root), wanted) for root in beside if root != folder.root.resolve())
    return next((one for one in found if one is not None), None)


def _plain(description: Description) -> bool:
    """Whether all of B_k is drawn alike."""
    sampling = description.sampling
    return isinstance(sampling, UniformSection) and not sampling.online_share


def _apart_from_sampling(description: Description) -> str:
    """Digest of all else that a run's policies and deployments depend on."""
    alike: dict[str, object] = {"summary": "", "sampling": STRATEGIES.chosen({})}
    return description.model_copy(update=alike).tuning_digest()


def _read(other: RunFolder, wanted: str) -> Uniform | None:
    try:
        if not other.results.is_file():
            return None
        theirs = Description.load(other.description)
        if not _plain(theirs) or _apart_from_sampling(theirs) != wanted:
            return None
        results = _Results.model_validate_json(other.results.read_bytes())
    except (OSError, UserError, ValidationError):
        return None
    recommended = results.recommended
    if not results.complete or recommended is None or recommended.greedy_return is None:
        return None
    return Uniform(Path(other.root).name, recommended.policy, recommended.greedy_return)
