"""What a deployment's log says of the policies that acted in it."""

from pathlib import Path

import numpy as np

from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import check_whole
from otc_dist.run.measured_returns import Measured, horizon, measure, team_rewards
from otc_dist.transitions import Bool, Float32


def read_measured(path: Path) -> tuple[int, Measured]:
    """h and the estimate, of a log that holds its whole deployment.

    The agents come to the same numbers, to the bit, by their own rewards, where these are alike.

    Raises:
        UserError: missing, no log, or not the whole of its deployment.
        TooFewError: it holds too few episodes to measure anything.
        DamagedLogError: it is damaged.
    """
    with OpenLog(path) as log:
        check_whole(log)
        agents, copies = range(len(log.header.team.agents)), log.header.copies
        parts: list[tuple[Float32, Bool, Bool]] = []
        for rows in log.blocks():
            own = [log.layout.transitions(rows, agent) for agent in agents]
            rewards = team_rewards([each.rewards for each in own])
            parts.append((rewards, own[0].terminated, own[0].truncated))
        h = horizon(log.steps(), copies, log.header.team.max_episode_steps)
    shape = (-1, copies)
    return h, measure(
        np.concatenate([rewards for rewards, _, _ in parts]).reshape(shape),
        np.concatenate([terminated for _, terminated, _ in parts]).reshape(shape),
        np.concatenate([truncated for _, _, truncated in parts]).reshape(shape),
        h,
    )
