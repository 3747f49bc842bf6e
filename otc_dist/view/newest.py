"""The newest steps of a run, from the log that its env host writes ahead: nobody else is asked."""

from typing import NamedTuple

import numpy as np

from otc_dist.deployment_log.format import existing
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.replay.selection import Selection
from otc_dist.replay.timeline import Timeline, read_timeline
from otc_dist.run.folder import RunFolder
from otc_dist.scenes.families import find
from otc_dist.scenes.scene import Scene
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError

_SECONDS = 4.0  # of the task's own time that a stretch lasts
_COPY = 0  # which is shown


class Step(NamedTuple):
    """A step of a run."""

    deployment: int
    number: int


def scene_of(team: TeamSpec) -> Scene:
    """What is to be seen. Raises UserError if nothing is."""
    scene = find(team)
    if scene is None:
        raise UserError(
            f"there is nothing to view: the states of {team.env_id} do not say what it looks like;"
            " python -m otc_dist.replay LOG --html shows actions and rewards"
        )
    return scene


class Newest:
    """Reads the log of a run's newest deployment, again and again; on one thread at a time."""

    def __init__(self, folder: RunFolder) -> None:
        self._folder, self._deployment = folder, 0
        self._scene: Scene | None = None  # of that deployment, once it is known
        self._starts, self._end = [0], 0  # of the copy's episodes, among so many steps

    def stretch(self, after: Step | None = None) -> Timeline | None:
        """The newest steps, as long as a few seconds of the task's own time; None: there are none.

        Args:
            after: what has been seen already: only steps that follow it.

        Raises:
            UserError: the log is damaged, or there is nothing to be seen in it.
        """
        while existing(self._folder.deployment(self._deployment + 1)).exists():
            self._deployment, self._scene = self._deployment + 1, None
            self._starts, self._end = [0], 0
        if not self._deployment:
            return None
        with OpenLog(self._folder.deployment(self._deployment)) as log:
            self._find_episodes(log)
            team = log.header.team
            scene = self._scene = self._scene or scene_of(team)
            start = max(0, self._end - round(_SECONDS / scene.seconds))
            if after is not None and after.deployment == self._deployment:
                start = max(start, after.number + 1)
            if start >= self._end:
                return None
            part = Selection(start, self._end, team.names, _COPY)
            return read_timeline(log, dict(enumerate(self._starts)), part, scene)

    def _find_episodes(self, log: OpenLog) -> None:
        """Read on from where it was read before. What a resumed run lost it writes again."""
        if log.extent.end < self._end:
            self._starts, self._end = [0], 0
        for rows in log.blocks(self._end):
            ended = (rows["terminated"] | rows["truncated"])[:, _COPY]
            self._starts += (rows["step"][np.flatnonzero(ended)] + 1).tolist()
            self._end = int(rows["step"][-1]) + 1
