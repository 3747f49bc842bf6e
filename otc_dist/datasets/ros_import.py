"""Read a ROS 2 recording as a team's data, by a mapping file (see `ros_mapping`).

Step k begins with the k-th message of the clock's topic, at t_k, and ends with the next one:

- s is what was last seen of each topic at t_k, s' at t_{k+1};
- a is the last command from t_k to before t_{k+1};
- r and the ends are the last ones after t_k, up to t_{k+1} with it.

A step in which one of them is missing is dropped; nothing is held or guessed. After an end the next
step is dropped too: it leads from the last observation of an episode to the first of another.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otc_dist.datasets import rosbag
from otc_dist.datasets.card import file_sha256
from otc_dist.datasets.found import Found, kept, left_out
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.recording import flags, numbers
from otc_dist.datasets.ros_mapping import Mapping, Numbers
from otc_dist.datasets.rosbag import Bag
from otc_dist.datasets.writing import Provenance, versions
from otc_dist.envs import registry
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32


def read(source: Path, mapping_file: Path, env_id: str) -> Found:
    """Read a recording.

    Args:
        source: an MCAP file, or the folder of several that follow one another.

    Raises:
        UserError: no such file or environment, a mapping of another team, damage, missing topics
            or fields, sizes other than the environment's, or bad values.
    """
    if not env_id:
        raise UserError(f"say what environment the data of {source} are of, with --env")
    team = registry.team_spec(env_id)
    mapping = Mapping.read(mapping_file, team)
    files = rosbag.files_of(source)
    bag = rosbag.read(files, mapping.numbers, mapping.clock)
    data, begun, notes = _Steps(bag, mapping, team, str(source)).data()
    left = kept(data, begun, np.ones(len(data), np.bool_), team, str(source))
    notes += left.notes + left_out("topics", bag.others)
    recipe = {path.name: file_sha256(path) for path in (*files, mapping_file)}
    made = Provenance(
        f"imported from the ROS 2 recording {source.name}",
        recipe,
        versions("mcap", "mcap-ros2-support"),
        left.returns,
        left.incomplete,
        notes,
    )
    return Found(team, left.data, made)


class _Steps:
    """The steps of a recording: step k of T is from `clock[k]` to `clock[k + 1]`."""

    def __init__(self, bag: Bag, mapping: Mapping, team: TeamSpec, source: str) -> None:
        self._bag, self._mapping, self._team, self._source = bag, mapping, team, source
        self._clock = bag.times[mapping.clock]
        if (np.diff(self._clock) == 0).any():
            raise UserError(f"{source}: two messages of {mapping.clock} have the same time")
        if len(self._clock) < 2:
            raise UserError(f"{source}: one message of {mapping.clock} makes no step")
        self._lacking: dict[str, Bool] = {}  # what -> the steps that lack it, (T,)

    def data(self) -> tuple[JointTransitions, Bool, tuple[str, ...]]:
        """The whole steps; whether their episodes are there from their first one (n,); notes."""
        terminated, truncated = (
            self._ends(name) for name in (self._mapping.terminated, self._mapping.truncated)
        )
        ended = terminated | truncated
        between = np.concatenate(([False], ended[:-1]))
        parts = []  # of each agent: what was seen (T + 1, O), a (T, A), r (T, 1)
        for spec in self._team.agents:
            agent = self._mapping.agents[spec.name]
            sources = [*agent.observation, *agent.legals]
            reward = agent.reward or self._mapping.reward
            parts.append((self._seen(sources), self._acted(agent.action), self._rewards(reward)))
        lacking = np.any([between, *self._lacking.values()], axis=0)
        kept = np.flatnonzero(~lacking)
        starts = np.diff(kept, prepend=-2) != 1
        starts |= np.concatenate(([True], ended[kept[:-1]]))[: len(kept)]
        episodes = np.cumsum(starts) - 1
        begins = between[kept - 1] | (kept == kept[:1])
        data = JointTransitions(
            observations=self._checked("observation", [part[0][kept] for part in parts]),
            actions=self._checked("action", [part[1][kept] for part in parts]),
            rewards=tuple(
                rows[:, 0] for rows in self._checked("reward", [part[2][kept] for part in parts])
            ),
            next_observations=self._checked("observation", [part[0][kept + 1] for part in parts]),
            terminated=terminated[kept],
            truncated=truncated[kept] & ~terminated[kept],
            episodes=episodes,
        )
        notes = [f"{len(kept)} of {len(between)} steps from a message of {self._mapping.clock} on"]
        notes += [
            f"{int((none & ~between).sum())} steps were dropped: {what} is missing"
            for what, none in self._lacking.items()
            if (none & ~between).any()
        ]
        if between.any():
            notes.append(f"{int(between.sum())} steps were dropped: they lie between episodes")
        return data, begins[starts][episodes], tuple(notes)

    def _checked(self, what: str, arrays: Sequence[NDArray[np.float64]]) -> tuple[Float32, ...]:
        """As float32, of the sizes that the team has. Raises UserError."""
        made = []
        for spec, rows in zip(self._team.agents, arrays, strict=True):
            sizes = {"observation": spec.observation_size, "action": spec.action_size, "reward": 1}
            name = f"{what} of {spec.name}"
            made.append(numbers(rows, name, (-1, sizes[what]), self._source))
        return tuple(made)

    def _seen(self, sources: Sequence[Numbers]) -> NDArray[np.float64]:
        """What was last seen when each step began, and the last one ended, (T + 1, O)."""
        columns = []
        for source in sources:
            series = self._bag.series[source]
            places = np.searchsorted(series.times, self._clock, side="right") - 1
            self._lack("an observation", (places < 0)[:-1])
            columns.append(series.values[places])
        return np.concatenate(columns, axis=1)

    def _acted(self, sources: Sequence[Numbers]) -> NDArray[np.float64]:
        """The last command of each step, (T, A)."""
        columns = []
        for source in sources:
            series = self._bag.series[source]
            places = np.searchsorted(series.times, self._clock[1:], side="left") - 1
            late = (places < 0) | (series.times[places] < self._clock[:-1])
            self._lack("an action", late)
            columns.append(series.values[places])
        return np.concatenate(columns, axis=1)

    def _rewards(self, source: Numbers | None) -> NDArray[np.float64]:
        """The last reward of each step, (T, 1)."""
        assert source is not None  # by the mapping
        series = self._bag.series[source]
        places = np.searchsorted(series.times, self._clock[1:], side="right") - 1
        self._lack("a reward", (places < 0) | (series.times[places] <= self._clock[:-1]))
        return series.values[places]

    def _lack(self, what: str, steps: Bool) -> None:
        self._lacking[what] = self._lacking.get(what, np.zeros_like(steps)) | steps

    def _ends(self, source: Numbers | None) -> Bool:
        """The steps in which the flag was set, (T,)."""
        found = np.zeros(len(self._clock) - 1, np.bool_)
        if source is not None:
            series = self._bag.series[source]
            raised = flags(series.values, str(source), len(series.values), self._source)
            steps = np.searchsorted(self._clock, series.times[raised], side="left") - 1
            found[steps[(steps >= 0) & (steps < len(found))]] = True
        return found
