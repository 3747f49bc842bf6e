"""Online tuning for offline decentralized multi-agent RL, as a distributed system.

What is here is stable and typed: a name stays, with what it takes, from one minor version to the
next. Everything else may move. Each name is imported when it is first used: torch for `Policy` and
`Learner` only, a simulator for `make_env` only.

    Policy         a trained policy by itself: `Policy.load(...)`, `act`, `export`
    read_log       a deployment's log as arrays, and `to_pandas()`
    load_dataset   the offline data of one agent
    make_env       copies of an environment that step together
    Description    everything a run depends on: TOML in and out
    Learner        one agent's brain: pretrain, act, tune, checkpoint
    Transitions    <s, a_i, r, s'> of one agent, as data sets, logs and learners have them
    UserError      what is raised for a mistake in a file or a name, in one line
"""

from importlib import import_module

TYPE_CHECKING = False  # as in `typing`, whose import would take longer than all the rest
if TYPE_CHECKING:
    from otc_dist.datasets.front import load_dataset as load_dataset
    from otc_dist.datasets.front import make_env as make_env
    from otc_dist.deployment_log.arrays import Log as Log
    from otc_dist.deployment_log.arrays import read_log as read_log
    from otc_dist.description import Description as Description
    from otc_dist.learner.learner import Learner as Learner
    from otc_dist.learner.policy import Policy as Policy
    from otc_dist.terminal.errors import UserError as UserError
    from otc_dist.transitions import Transitions as Transitions

__version__ = "0.1.0"

_HOMES = {
    "Description": "otc_dist.description",
    "Learner": "otc_dist.learner.learner",
    "Log": "otc_dist.deployment_log.arrays",
    "Policy": "otc_dist.learner.policy",
    "Transitions": "otc_dist.transitions",
    "UserError": "otc_dist.terminal.errors",
    "load_dataset": "otc_dist.datasets.front",
    "make_env": "otc_dist.datasets.front",
    "read_log": "otc_dist.deployment_log.arrays",
}
__all__ = ["__version__", *_HOMES]


if not TYPE_CHECKING:  # or a name that does not exist would have a type

    def __getattr__(name: str) -> object:
        """A name of the above, imported now (PEP 562)."""
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name)
        found: object = getattr(import_module(_HOMES[name]), name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
