"""Which PettingZoo environments are refused, at once or when they break their word."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete

from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError

from .tiny_pettingzoo import Tiny, begun, case, played


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
        (case(done=Box(0, 2**40, (1,), np.int64)), "float32 cannot distinguish whole numbers"),
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
        (case(possible_agents=["a/b"]), "'a/b' is not a valid name: a name is of letters, digits"),
        (case(possible_agents=["a", "../b"]), "'../b' is not a valid name"),
        (case(possible_agents=["a", ""]), "'' is not a valid name"),
        (case(possible_agents=["a", "x" * 200]), "is not a valid name"),
        (case(possible_agents=["-a"]), "'-a' is not a valid name"),
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
