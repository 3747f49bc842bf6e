"""What all processes of a run derive from its description, so that they understand each other."""

from otc_dist.bus.links import QUICK_PAYLOAD
from otc_dist.bus.replies import RunSpec, history_rows
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.spec import TeamSpec


def copies_by_phase(description: Description) -> dict[str, int]:
    """E, by phase."""
    episodes = max(description.evaluation.episodes, 1)  # one is asked for in real time without any
    return {
        "deployment": description.env.copies,
        "evaluation": registry.affordable(description.env.id, episodes),
        "done": 0,
    }


def run_spec(description: Description, team: TeamSpec) -> RunSpec:
    """What env host and learners must agree on."""
    return RunSpec(team.env_id, team.agents, description.shared_digest())


def longest_message(description: Description, team: TeamSpec) -> int:
    """The longest message, bytes: the description's limit; less where links can be quick."""
    limit, copies = description.bus.maximum_payload, max(copies_by_phase(description).values())
    # A step's page of history is longer than its question.
    short = all(history_rows(agent, QUICK_PAYLOAD) >= copies for agent in team.agents)
    return min(limit, QUICK_PAYLOAD) if short else limit
