"""Which PettingZoo environments are admitted, and what becomes of what they say of themselves."""

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box

from otc_dist.datasets import store
from otc_dist.datasets.source import Uniform
from otc_dist.envs import pettingzoo_admission, registry
from otc_dist.envs.base import BatchedEnv

from .tiny_pettingzoo import Tiny, begun, case, played

CLASSIC = "adversary crypto push reference speaker_listener spread tag world_comm"
MPE = [
    *(f"mpe2.simple_{name}_v{3 + (name == 'speaker_listener')}" for name in CLASSIC.split()),
    *(f"mpe2.{name}" for name in ("simple_v3", "simple_formation_v1", "simple_line_v1")),
    "mpe2.collect_treasure_v1",
]
REAL = [*MPE, "pettingzoo.classic.rps_v2", "pettingzoo.sisl.pursuit_v5"]


@pytest.mark.parametrize("module", REAL)
def test_a_real_environment_is_admitted_as_it_describes_itself(module: str) -> None:
    env_id = f"{module}:parallel_env"
    env, theirs = begun(env_id, 2), importlib.import_module(module).parallel_env()
    team, random = env.spec, np.random.default_rng(0)
    assert team.names == tuple(theirs.possible_agents)
    assert [agent.choices for agent in team.agents] == [
        theirs.action_space(name).n for name in team.names
    ]
    behaviour = Uniform(team)
    steps = min(team.max_episode_steps, 30)
    noise = behaviour.noise(random, steps * 2).reshape(steps, 2, -1)
    ends = [env.step(behaviour.act(env.observe(), draw)).truncated.tolist() for draw in noise]
    limit = team.max_episode_steps if team.max_episode_steps <= 30 else 0
    assert ends == [[step == limit] * 2 for step in range(1, steps + 1)]


@pytest.mark.parametrize("module", MPE)
def test_with_continuous_actions_as_well(
    name_of: Callable[[Callable[[], Any]], str], module: str
) -> None:
    make = importlib.import_module(module).parallel_env
    env = begun(name_of(lambda: make(continuous_actions=True)))
    for agent in env.spec.agents:
        assert (
            agent.choices == 0 and set(agent.action_low) == {0.0} and set(agent.action_high) == {1}
        )
    behaviour = Uniform(env.spec)
    noise = behaviour.noise(np.random.default_rng(0), 3)
    for draw in noise:
        env.step(behaviour.act(env.observe(), draw[np.newaxis]))


def sent(env: BatchedEnv) -> list[Any]:
    """What each agent's action was, as the environment of copy 0 got it."""
    return list(env._envs[0].sent.values())  # type: ignore[attr-defined]


@pytest.mark.parametrize("kind", ["int8", "int64", "uint8", "bool"])
def test_an_action_of_whole_numbers_is_rounded_and_that_is_said(
    name_of: Callable[[Callable[[], Any]], str], kind: str
) -> None:
    low = 0 if kind in ("uint8", "bool") else -1
    env_id = name_of(case(done=Box(low, 1, (2,), np.dtype(kind).type)))
    env = begun(env_id)
    env.step([np.array([[0.7, -0.7]], np.float32), np.array([[7.0, 0.4]], np.float32)])
    assert [action.tolist() for action in sent(env)] == [[1, low], [1, 0]]
    assert all(action.dtype == kind for action in sent(env))
    assert registry.remarks(env_id) == ("actions of left, right are rounded to whole numbers",)


def test_an_entry_of_one_value_is_filled_in_and_that_is_said(
    name_of: Callable[[Callable[[], Any]], str],
) -> None:
    box = Box(np.array([[-1, 3], [0, 2]], np.float32), np.array([[1, 3], [5, 2]], np.float32))
    env_id = name_of(case(done=box))
    env = begun(env_id)
    assert env.spec.agents[0].action_low == (-1, 0) and env.spec.agents[0].action_high == (1, 5)
    env.step([np.array([[0.5, 9.0]], np.float32)] * 2)
    assert [action.tolist() for action in sent(env)] == [[[0.5, 3], [5, 2]]] * 2
    assert registry.remarks(env_id)[1] == (
        "2 of 4 entries of the actions of right have one value only: they are filled in"
    )
    assert store.ensure(f"{env_id}/random", 20).notes == registry.remarks(env_id)


def test_a_bound_beside_float32_is_not_exceeded(
    name_of: Callable[[Callable[[], Any]], str],
) -> None:
    box = Box(0.1, 0.3, (1,), np.float64)  # the nearest float32 is above 0.3
    env = begun(name_of(case(done=box)))
    env.step([np.array([[1.0]], np.float32)] * 2)
    assert all(box.contains(action) for action in sent(env))


def test_agents_that_are_numbers_keep_them(name_of: Callable[[Callable[[], Any]], str]) -> None:
    env = begun(name_of(case(possible_agents=[0, 1])))
    assert env.spec.names == ("0", "1")
    assert played(env, 5)[-1] == (False, True)


def test_an_agent_that_is_not_named_has_not_ended(
    name_of: Callable[[Callable[[], Any]], str],
) -> None:
    def ends(self: Tiny) -> tuple[Any, Any]:
        return {}, dict.fromkeys(self.agents, True) if self.count >= 3 else {}

    env = begun(name_of(case(ends=ends)))
    assert played(env, 3) == [(False, False), (False, False), (False, True)]


def test_an_end_of_which_some_have_arrived_and_others_run_out_of_time_is_one_of_time(
    name_of: Callable[[Callable[[], Any]], str],
) -> None:
    def ends(self: Tiny) -> tuple[Any, Any]:
        last = self.count == 3
        return {"left": last, "right": False}, {"left": False, "right": last}

    assert played(begun(name_of(case(ends=ends))), 3)[-1] == (False, True)


@pytest.mark.parametrize(
    ("given", "limit"),
    [
        (None, pettingzoo_admission.MAX_STEPS),
        (float("inf"), pettingzoo_admission.MAX_STEPS),
        (3, 3),
        (np.int64(3), 3),
        (3.0, 3),
        (10**300, pettingzoo_admission.MOST_STEPS),
    ],
)
def test_a_limit_may_be_said_in_many_ways(
    name_of: Callable[[Callable[[], Any]], str], given: object, limit: int
) -> None:
    assert registry.team_spec(name_of(case(max_cycles=given))).max_episode_steps == limit


def test_an_environment_that_is_not_derived_from_theirs_may_lack_what_is_not_needed(
    name_of: Callable[[Callable[[], Any]], str],
) -> None:
    attributes = {name: value for name, value in vars(Tiny).items() if name[:2] != "__"}
    env = begun(name_of(type("Duck", (), attributes)))  # no `unwrapped`, no `close`
    assert played(env, 5)[-1] == (False, True)
    env.close()


def test_without_a_limit_the_episodes_that_it_ends_itself_are_complete(
    name_of: Callable[[Callable[[], Any]], str],
) -> None:
    card = store.ensure(f"{name_of(Tiny)}/random", 22)  # the last episode is cut where that is full
    assert (card.episodes, card.incomplete_episodes) == (4, 1)
    assert card.returns is not None and card.returns.mean == 5.0
    unsaid = store.ensure(f"{name_of(case(max_cycles=9))}/random", 22)  # these were cut below it
    assert (unsaid.episodes, unsaid.incomplete_episodes) == (0, 5)
