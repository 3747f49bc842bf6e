"""Read a joint Minari data set: dictionaries by agent, as `--export minari` writes for a team.

    episode_k/observations/AGENT (T + 1, O)      episode_k/actions/AGENT (T, a)
    episode_k/infos/rewards/AGENT (T,), or `rewards` (T,) that all agents share
    episode_k/terminations, truncations (T,)

A step with both flags is one in which the simulator broke off: it did not happen, and is left out,
as from a log.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from otc_dist.datasets import minari
from otc_dist.datasets.hdf5 import array, attributes, names
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.recording import EpisodeStarts, clipped, flags, numbers
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32, choice_problem

if TYPE_CHECKING:
    import h5py


def is_joint(file: "h5py.File", source: str) -> bool:
    """Whether the episodes of an open data file hold dictionaries. UserError if it is damaged."""
    found = minari.episodes(file, source)
    return bool(found) and array(file, f"{found[0]}/observations", source) is None


def read(
    file: "h5py.File", spec: TeamSpec, source: str
) -> tuple[JointTransitions, Bool, tuple[str, ...]]:
    """Read an open data file of a team.

    Returns:
        the data; whether each row's episode is there from its first step (T,); notes.

    Raises:
        UserError: damage, missing arrays, other agents or sizes than the environment's, or bad
            values.
    """
    parts: list[JointTransitions] = []
    begun: list[Bool] = []
    beginnings, broken = EpisodeStarts(), 0
    for index, name in enumerate(minari.episodes(file, source)):
        part = _episode(file, name, spec, f"{source}: {name}", index)
        ended = bool(len(part) and (part.terminated[-1] or part.truncated[-1]))
        place = minari.place(attributes(file, name, source))
        whole = beginnings.has(place, len(part), ended)
        happened = np.flatnonzero(~(part.terminated & part.truncated))
        broken += len(part) - len(happened)
        parts.append(part[happened])
        begun.append(np.full(len(happened), whole, np.bool_))
    data = JointTransitions.concatenate(parts)
    for number, agent in enumerate(spec.agents):
        if problem := choice_problem(data.of_agent(number), agent.choices):
            raise UserError(f"{source}: {agent.name}: {problem}")
    actions, notes = clipped(data.actions, spec)
    data = replace(data, actions=actions)
    if broken:
        notes += (f"without {broken} steps whose simulator broke off",)
    return data, np.concatenate(begun), notes


def _episode(
    file: "h5py.File", name: str, spec: TeamSpec, where: str, index: int
) -> JointTransitions:
    for field in ("observations", "actions"):
        agents = names(file, where, f"{name}/{field}")
        if set(agents) != set(spec.names):
            raise UserError(
                f"{where} has {field} of {', '.join(agents)}, but the agents of {spec.env_id} are"
                f" {', '.join(spec.names)}"
            )

    def of(field: str, shape: tuple[int, ...]) -> Float32:
        found = array(file, f"{name}/{field}", where)
        if found is None:
            raise UserError(f"{where} has no array {field}")
        return numbers(found, field, shape, where)

    actions = [of(f"actions/{a.name}", (-1, a.action_size)) for a in spec.agents]
    length = len(actions[0])
    seen = [of(f"observations/{a.name}", (length + 1, a.observation_size)) for a in spec.agents]
    each = array(file, f"{name}/infos/rewards/{spec.names[0]}", where) is not None
    rewards: Sequence[Float32] = (
        [of(f"infos/rewards/{agent}", (length,)) for agent in spec.names]
        if each
        else [of("rewards", (length,))] * len(spec.names)
    )
    ends = []
    for field in ("terminations", "truncations"):
        found = array(file, f"{name}/{field}", where)
        if found is None:
            raise UserError(f"{where} has no array {field}")
        ends.append(flags(found, field, length, where))
    return JointTransitions(
        observations=tuple(rows[:-1] for rows in seen),
        actions=tuple(actions),
        rewards=tuple(rewards),
        next_observations=tuple(rows[1:] for rows in seen),
        terminated=ends[0],
        truncated=ends[1],
        episodes=np.full(length, index, np.int64),
    )
