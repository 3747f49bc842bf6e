"""Read D4RL's HDF5 files: flat arrays, episodes one after another.

    observations, actions, rewards, terminals, timeouts?, next_observations?, infos/{qpos,qvel}?

The true successor of a transition, in order of preference:

1. `next_observations`, unless at an episode's end it equals the next row's observation: then the
   writer joined across the reset (as D4RL's own loader does), and it is not a successor.
2. The next row's observation, inside an episode; never across a terminal or a timeout.
3. One step simulated again from `infos/qpos` and `infos/qvel`, which are before the step. This
   keeps the terminations of files that lack `next_observations`. It is used only if it
   reproduces the successors that are known; how well is noted on the card.

What is left has no known successor and is dropped.
"""

from typing import TYPE_CHECKING

import numpy as np

from otc_dist.datasets.hdf5 import array
from otc_dist.datasets.recording import Recording, flags, joint_sizes, numbers
from otc_dist.datasets.successors import resimulate
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32

if TYPE_CHECKING:
    import h5py

OPTIONAL = ("timeouts", "next_observations")
REQUIRED = ("observations", "actions", "rewards", "terminals")


def read(file: "h5py.File", spec: TeamSpec, source: str) -> Recording:
    """Read an open file.

    Raises:
        UserError: damage, missing arrays, sizes other than the environment's, or bad values.
    """
    arrays = {name: array(file, name, source) for name in (*REQUIRED, *OPTIONAL)}
    if missing := [name for name in REQUIRED if arrays[name] is None]:
        raise UserError(f"{source}: no {', '.join(missing)} in it; is this a D4RL file?")
    present = {name: found for name, found in arrays.items() if found is not None}
    width, action_size = joint_sizes(spec, source)
    observations = numbers(present["observations"], "observations", (-1, width), source)
    length = len(observations)
    if length == 0:
        raise UserError(f"{source} is empty")
    actions = numbers(present["actions"], "actions", (length, action_size), source)
    rewards = numbers(present["rewards"].reshape(-1), "rewards", (length,), source)
    terminated = flags(present["terminals"], "terminals", length, source)
    notes: tuple[str, ...] = ()
    if "timeouts" in present:
        timeouts = flags(present["timeouts"], "timeouts", length, source)
    else:
        timeouts = _timeouts(terminated, spec.max_episode_steps)
        notes = (f"no timeouts in the file: episodes were cut at {spec.max_episode_steps} steps",)
    ends = terminated | timeouts
    given = present.get("next_observations")
    if given is not None:
        given = numbers(given, "next_observations", observations.shape, source)
    successors, known = _successors(given, observations, ends)
    recording = Recording(
        observations=observations,
        actions=actions,
        rewards=rewards,
        next_observations=successors,
        known=known,
        terminated=terminated,
        truncated=timeouts & ~terminated,
        episodes=np.concatenate(([0], np.cumsum(ends[:-1]))).astype(np.int64),
        begun=np.ones(length, np.bool_),
        notes=notes,
    )
    if known.all():
        return recording
    qpos, qvel = (array(file, f"infos/{name}", source) for name in ("qpos", "qvel"))
    if qpos is None or qvel is None:
        return recording
    shape = (length, (width + 1) // 2)
    qpos = numbers(qpos, "infos/qpos", shape, source)
    qvel = numbers(qvel, "infos/qvel", shape, source)
    return resimulate(recording, spec, qpos, qvel)


def _successors(given: Float32 | None, observations: Float32, ends: Bool) -> tuple[Float32, Bool]:
    """Successors (T, O), and where they are the true ones (T,)."""
    following = np.roll(observations, -1, axis=0)
    boundaries = ends.copy()
    boundaries[-1] = True
    if given is None:
        return following, ~boundaries
    known = ~(boundaries & (given == following).all(axis=1))
    return given, known


def _timeouts(terminated: Bool, limit: int) -> Bool:
    """Ends by the time limit, where only terminations are known: each `limit`-th step."""
    index = np.arange(len(terminated))
    starts = np.maximum.accumulate(np.where(np.roll(terminated, 1), index, 0))
    timeouts: Bool = ((index - starts + 1) % limit == 0) & ~terminated
    return timeouts
