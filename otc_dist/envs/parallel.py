"""The PettingZoo view of an environment: one copy, dictionaries keyed by agent."""

import numpy as np
from gymnasium.spaces import Box, Discrete, Space
from pettingzoo import ParallelEnv

from otc_dist.envs.base import BatchedEnv
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Float32

Info = dict[str, object]  # PettingZoo gives info dictionaries no type
Action = Float32 | np.int64  # a vector, or the index of a discrete action


class ParallelView(ParallelEnv[str, Float32, Action]):  # type: ignore[misc]  # it is untyped
    """A PettingZoo `ParallelEnv` over one copy of any `BatchedEnv`.

    Agents with discrete actions find what is available in `infos[agent]["action_mask"]`, int8
    (choices,), 1 where available; other infos are empty. An action that is not available is
    refused, so sample by the mask: `action_space(agent).sample(infos[agent]["action_mask"])`.

    `reset(seed=s)` starts the episode of seed s; resets without a seed go on with seeds drawn
    from a generator that the last seed given has set.

    Raises:
        ValueError: the environment has more than one copy.
    """

    def __init__(self, env: BatchedEnv) -> None:
        if env.copies != 1:
            raise ValueError(f"a PettingZoo environment is one copy, not {env.copies}")
        self._env = env
        self._seeds = np.random.default_rng()
        self.metadata = {"name": env.spec.env_id, "render_modes": [], "is_parallelizable": True}
        self.render_mode = None
        self.possible_agents = list(env.spec.names)
        self.agents: list[str] = []
        self.observation_spaces = {
            agent.name: Box(-np.inf, np.inf, (agent.observation_size,), np.float32)
            for agent in env.spec.agents
        }
        self.action_spaces = {agent.name: _action_space(agent) for agent in env.spec.agents}

    def observation_space(self, agent: str) -> Box:
        """The agent's observations: unbounded float32."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space[Action]:
        """The agent's actions: float32 within its bounds, or an index."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, object] | None = None
    ) -> tuple[dict[str, Float32], dict[str, Info]]:
        """Start an episode; there are no `options`. Returns observations and infos."""
        if seed is None:
            episode_seed = int(self._seeds.integers(2**63))
        else:
            self._seeds = np.random.default_rng(seed)
            episode_seed = seed
        self._env.reset(np.array([0]), np.array([episode_seed], np.int64))
        self.agents = list(self.possible_agents)
        observations = self._observations()
        return observations, self._infos(observations)

    def step(
        self, actions: dict[str, Action]
    ) -> tuple[
        dict[str, Float32], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Info]
    ]:
        """One step of the whole team; after the episode's end `agents` is empty.

        Raises:
            ValueError: the episode is over, an agent has no action, or an action has the wrong
                shape, is not finite, or is not available.
        """
        if not self.agents:
            raise ValueError("the episode is over: call reset")
        if set(actions) != set(self.agents):
            raise ValueError(f"actions of {sorted(actions)}, but the agents are {self.agents}")
        rows = [np.asarray(actions[name], np.float32).reshape(1, -1) for name in self.agents]
        outcome = self._env.step(rows)
        names, observations = self.agents, self._observations()
        terminated, truncated = bool(outcome.terminated[0]), bool(outcome.truncated[0])
        if terminated or truncated:
            self.agents = []
        return (
            observations,
            {name: float(r[0]) for name, r in zip(names, outcome.rewards, strict=True)},
            dict.fromkeys(names, terminated),
            dict.fromkeys(names, truncated),
            self._infos(observations),
        )

    def close(self) -> None:
        """Close the environment."""
        self._env.close()

    def _observations(self) -> dict[str, Float32]:
        # Copies: PettingZoo's users may write into what they are given, and agents that see the
        # same thing share one array.
        observed = zip(self._env.spec.names, self._env.observe(), strict=True)
        return {name: rows[0].copy() for name, rows in observed}

    def _infos(self, observations: dict[str, Float32]) -> dict[str, Info]:
        infos: dict[str, Info] = {}
        for agent in self._env.spec.agents:
            mask = observations[agent.name][-agent.choices :] if agent.choices else None
            infos[agent.name] = {} if mask is None else {"action_mask": mask.astype(np.int8)}
        return infos


def _action_space(agent: AgentSpec) -> Space[Action]:
    if agent.choices:
        return Discrete(agent.choices)
    return Box(np.array(agent.action_low, np.float32), np.array(agent.action_high, np.float32))
