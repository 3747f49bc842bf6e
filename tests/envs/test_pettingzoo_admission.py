"""Which PettingZoo environments are admitted, and what becomes of what they say of themselves."""

import importlib
import itertools
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Space
from pettingzoo import ParallelEnv

from otc_dist.datasets import store
from otc_dist.datasets.source import Uniform
from otc_dist.envs import pettingzoo_admission, registry
from otc_dist.envs.base import BatchedEnv
from otc_dist.terminal.errors import UserError

_NUMBERS = itertools.count()


class Tiny(ParallelEnv):
    """Two agents, episodes of five steps; a case changes one thing."""

    possible_agents: Any = ("left", "right")
    seen: Space[Any] = Box(-1, 1, (2,), np.float32)
    done: Space[Any] = Box(-1, 1, (1,), np.float32)
    length = 5

    def observation_space(self, agent: Any) -> Space[Any]:
        return dict.fromkeys(self.possible_agents, self.seen)[agent]

    def action_space(self, agent: Any) -> Space[Any]:
        return dict.fromkeys(self.possible_agents, self.done)[agent]

    def reset(self, seed: int | None = None, options: object = None) -> tuple[Any, Any]:
        self.agents, self.count = list(self.possible_agents), 0
        return self.look(), {}

    def look(self) -> Any:
        return dict.fromkeys(self.agents, np.full(2, self.count, np.float32))

    def ends(self) -> tuple[Any, Any]:
        return (
            dict.fromkeys(self.agents, False),
            dict.fromkeys(self.agents, self.count >= self.length),
        )

    def rewards(self) -> Any:
        return dict.fromkeys(self.agents, 1.0)

    def step(self, actions: Any) -> tuple[Any, ...]:
        self.sent = actions
        self.count += 1
        return (self.look(), self.rewards(), *self.ends(), {})


def case(**changed: Any) -> type[Tiny]:
    """The environment with some of its attributes changed."""
    return type("Case", (Tiny,), changed)


@pytest.fixture
def name_of(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], Any]], str]:
    """The id of an environment that a function makes, in a module of its own."""

    def put(make: Callable[[], Any]) -> str:
        module = ModuleType(f"admission_case_{next(_NUMBERS)}")
        module.parallel_env, module.__file__ = make, __file__  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, module.__name__, module)
        return f"{module.__name__}:parallel_env"

    return put


def begun(env_id: str, copies: int = 1) -> BatchedEnv:
    env = registry.make(env_id, copies)
    env.reset(np.arange(copies), np.arange(copies))
    return env


def played(env: BatchedEnv, steps: int) -> list[tuple[bool, bool]]:
    """How each step of one copy ended: terminated, truncated."""
    still = [np.zeros((env.copies, agent.action_size), np.float32) for agent in env.spec.agents]
    outcomes = [env.step(still) for _ in range(steps)]
    return [(bool(o.terminated[0]), bool(o.truncated[0])) for o in outcomes]


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


def raising(error: BaseException) -> Any:
    def raise_it(self: object, *_: object) -> None:
        raise error

    return raise_it


F32 = np.finfo(np.float32)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (case(done=Box(-1e300, 1e300, (1,), np.float64)), "float32 cannot scale that"),
        (case(done=Box(F32.min, F32.max, (1,))), "float32 cannot scale that"),
        (case(done=Box(3e38, 3.3e38, (1,))), "float32 cannot scale that"),
        (case(done=Box(0, 1e-60, (1,), np.float64)), "float32 cannot scale that"),
        (case(done=Box(1e9, 1e9 + 1, (1,), np.float64)), "float32 cannot scale that"),
        (case(done=Box(-np.inf, 1, (1,))), "actions must be bounded"),
        (case(done=Box(0, 2**40, (1,), np.int64)), "float32 does not tell whole numbers beyond"),
        (case(done=Box(1, 1, (2,))), "in which there is nothing to choose"),
        (case(done=Box(1, 1, (0,))), "left sends 0 numbers"),
        (case(seen=Box(-1, 1, (0,))), "left observes 0 numbers"),
        (case(seen=Discrete(10**12)), "left observes 1,000,000,000,000 numbers"),
        (case(done=Discrete(10**12)), "left observes 1,000,000,000,002 numbers"),
        (case(done=MultiDiscrete([2, 2])), "only Box and Discrete can be used"),
        (case(seen=Dict({c: MultiBinary(9) for c in "abcdefghijklmnop"})), "only Box and Discrete"),
        (case(possible_agents=[]), "has no agents"),
        (case(possible_agents=None), "TypeError: 'NoneType' object is not iterable"),
        (case(possible_agents=[0, "0"]), "two agents are called '0'"),
        (case(possible_agents=["a/b"]), "'a/b' is no name: a name is of letters, digits"),
        (case(possible_agents=["a", "../b"]), "'../b' is no name"),
        (case(possible_agents=["a", ""]), "'' is no name"),
        (case(possible_agents=["a", "x" * 200]), "is no name"),
        (case(possible_agents=["-a"]), "'-a' is no name"),
        (case(possible_agents=["a", "A"]), "two agents are called 'A'"),
        (case(possible_agents=["a", "host"]), "an agent cannot be called 'host'"),
        (case(possible_agents=["joint", "single"]), "an agent cannot be called 'joint'"),
        (case(possible_agents=property(raising(OSError("gone")))), "OSError: gone"),
        (case(observation_space=raising(KeyError("left"))), "asked for the spaces of left, it"),
        (case(action_space=raising(SystemExit("bye"))), "raised SystemExit: bye"),
        (case(unwrapped=property(raising(OSError("no")))), "asked for its max_cycles, it raised"),
        (case(max_cycles=0), "max_cycles is 0; it must be a whole number from 1 on, or None"),
        (case(max_cycles=2.5), "max_cycles is 2.5"),
        (case(max_cycles="25"), "max_cycles is '25'"),
        (case(max_cycles=float("nan")), "max_cycles is nan"),
        (case(agent_iter=None), "whose agents act in turn: return pettingzoo.utils.aec_to_par"),
        (raising(SystemExit(3)).__get__(0), "cannot be made: SystemExit: 3"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_in_one_line(
    name_of: Callable[[Callable[[], Any]], str], make: Callable[[], Any], said: str
) -> None:
    with pytest.raises(UserError) as raised:
        registry.team_spec(name_of(make))
    assert said in str(raised.value)
    assert "\n" not in str(raised.value) and len(str(raised.value)) < 300


def both(given: object) -> Any:
    return lambda self: dict.fromkeys(self.agents, given)


def ending(over: Any, cut: Any = False) -> Any:
    return lambda self: (dict.fromkeys(self.agents, over), dict.fromkeys(self.agents, cut))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"rewards": both("1.0")}, "the reward of left is '1.0'; it must be a number"),
        ({"rewards": both([1.0, 2.0])}, "the reward of left is [1.0, 2.0]"),
        ({"rewards": both(1j)}, "the reward of left is 1j"),
        ({"rewards": both(1e300)}, "the reward of left is 1e+300; it must be finite"),
        ({"rewards": both(10**400)}, "the reward of left is inf"),
        ({"rewards": lambda self: {"Left": 1.0}}, "step gave rewards of 'Left', which is none of"),
        ({"ends": lambda self: ({"__all__": True}, {})}, "step gave terminations of '__all__'"),
        ({"ends": ending("no")}, "in terminations, left is 'no'; it must be True or False"),
        ({"ends": ending(False, np.zeros(2))}, "in truncations, left is an array of shape (2,)"),
        ({"ends": ending(None)}, "in terminations, left is None"),
        ({"look": both("ab")}, "left observes 'ab'"),
        ({"look": both(np.array(["1", "2"]))}, "left observes an array of shape (2,), <U1"),
        ({"look": both([1e300, 0.0])}, "left observes NaN, infinity or more than float32"),
        ({"step": raising(SystemExit(0))}, "step raised SystemExit: 0"),
    ],
)
def test_what_it_gives_is_not_taken_on_trust(
    name_of: Callable[[Callable[[], Any]], str], changed: dict[str, Any], said: str
) -> None:
    class Later(Tiny):  # the first look is sound
        def reset(self, seed: int | None = None, options: object = None) -> tuple[Any, Any]:
            self.agents, self.count = list(self.possible_agents), 0
            return Tiny.look(self), {}

    env = begun(name_of(type("Case", (Later,), changed)))
    with pytest.raises(UserError) as raised:
        played(env, 1)
    assert said in str(raised.value) and "\n" not in str(raised.value)


def test_observations_of_whole_numbers_are_not_cut_down_to_them(
    name_of: Callable[[Callable[[], Any]], str],
) -> None:
    env = begun(name_of(case(seen=Box(0, 9, (2,), np.int64), look=both([1.5, -0.5]))))
    assert env.observe()[0].tolist() == [[1.5, -0.5]]


def test_a_mask_is_of_zeros_and_ones(name_of: Callable[[Callable[[], Any]], str]) -> None:
    def reset(self: Tiny, seed: object = None, options: object = None) -> tuple[Any, Any]:
        seen, _ = Tiny.reset(self)
        mask = [1.0, float("nan"), 0.0]
        return seen, {name: {"action_mask": mask} for name in self.agents}

    with pytest.raises(UserError, match="action_mask of left holds values other than 0 and 1"):
        begun(name_of(case(done=Discrete(3), reset=reset)))


def test_an_environment_that_is_another_each_time_is_refused(
    name_of: Callable[[Callable[[], Any]], str],
) -> None:
    sizes = itertools.count(1)
    with pytest.raises(UserError, match="has other agents or spaces each time that it is made"):
        registry.make(name_of(lambda: case(done=Box(-1, 1, (next(sizes),)))()), 2)
