"""What the env host answers to queries: the run's spec, and an agent's own history."""

from dataclasses import dataclass

from otc_dist.bus.wire import (
    BOOLEAN,
    PROTOCOL_VERSION,
    RejectedError,
    booleans,
    floats,
    name,
    natural,
    number,
    pack,
    raw,
    unpack,
)
from otc_dist.names import check_agents, checked_environment
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

_HEAD_BYTES = 1024  # more than a history page holds besides its arrays


@dataclass(frozen=True)
class RunSpec:
    """What env host and learners must agree on before they start."""

    env_id: str
    agents: tuple[AgentSpec, ...]
    description: str  # digest of the launch description


def encode_spec(run: str, spec: RunSpec) -> bytes:
    """The answer to a query for the spec."""
    agents = [
        [
            agent.name,
            agent.observation_size,
            list(agent.action_low),
            list(agent.action_high),
            agent.choices,
        ]
        for agent in spec.agents
    ]
    return pack([PROTOCOL_VERSION, run, spec.env_id, agents, spec.description])


def decode_spec(payload: bytes, run: str) -> RunSpec:
    """Raises RejectedError; for another protocol version with the sentence that names both."""
    _, _, env_id, agents, description = unpack(payload, run, 5)
    if type(agents) is not list:
        raise RejectedError("type")
    spec = RunSpec(name(env_id), tuple(_agent(agent) for agent in agents), name(description))
    try:
        checked_environment(spec.env_id)
        check_agents(agent.name for agent in spec.agents)
    except ValueError as error:
        raise RejectedError("name", str(error)) from None
    return spec


def _agent(fields: object) -> AgentSpec:
    if type(fields) is not list or len(fields) != 5:
        raise RejectedError("length")
    agent, observation_size, low, high, choices = fields
    if type(low) is not list or type(high) is not list or len(low) != len(high):
        raise RejectedError("type")
    return AgentSpec(
        name(agent),
        natural(observation_size),
        tuple(number(bound) for bound in low),
        tuple(number(bound) for bound in high),
        natural(choices),
    )


def history_rows(agent: AgentSpec, maximum_payload: int) -> int:
    """How many transitions of `agent` a history page of at most `maximum_payload` bytes holds."""
    row = 4 * (2 * agent.observation_size + agent.action_size + 1) + 2
    return max(0, maximum_payload - _HEAD_BYTES) // row


def encode_history(run: str, agent: str, deployment: int, start: int, page: Transitions) -> bytes:
    """A page of an agent's own transitions of deployment k, from step `start` on."""
    numbers = [page.observations, page.actions, page.rewards, page.next_observations]
    ends = [page.terminated, page.truncated]
    head = [PROTOCOL_VERSION, run, agent, deployment, start, len(page)]
    return pack([*head, *map(raw, numbers), *(raw(array, BOOLEAN) for array in ends)])


def decode_history(
    payload: bytes, run: str, agent: AgentSpec, deployment: int, start: int
) -> Transitions:
    """The page that was asked for. Raises RejectedError for anything else."""
    fields = unpack(payload, run, 12)
    if fields[2] != agent.name:
        raise RejectedError("agent")
    if natural(fields[3]) != deployment or natural(fields[4]) != start:
        raise RejectedError("stale")
    rows = natural(fields[5])
    return Transitions(
        floats(fields[6], rows, agent.observation_size),
        floats(fields[7], rows, agent.action_size),
        floats(fields[8], rows),
        floats(fields[9], rows, agent.observation_size),
        booleans(fields[10], rows),
        booleans(fields[11], rows),
    )
