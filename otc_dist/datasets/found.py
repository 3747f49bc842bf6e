"""What an importer makes of others' files, before it has a name among the data sets."""

from dataclasses import dataclass

from otc_dist.datasets.card import episode_returns, team_rewards
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.writing import Provenance
from otc_dist.envs import registry
from otc_dist.spec import TeamSpec
from otc_dist.transitions import Bool, Float64


@dataclass(frozen=True)
class Found:
    """A team's data, and what their card is to say of them."""

    team: TeamSpec
    data: JointTransitions
    made: Provenance


def team_returns(data: JointTransitions, begun: Bool, env_id: str) -> tuple[Float64, int]:
    """Team returns of the complete episodes, and the number of the others.

    Args:
        begun: whether the row's episode is there from its first step, (T,).
    """
    return episode_returns(
        team_rewards(data.rewards),
        data.terminated,
        data.truncated,
        data.episodes,
        begun,
        registry.time_limit(env_id),
    )
