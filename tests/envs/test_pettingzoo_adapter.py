"""A PettingZoo environment of a user's own, in a module of the folder that one starts from."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mpe2 import simple_spread_v3

from otc_dist.datasets import store
from otc_dist.datasets.source import Uniform
from otc_dist.envs import pettingzoo_adapter, registry
from otc_dist.envs.rollout import Rollout
from otc_dist.terminal.errors import UserError

SPREAD = """
from mpe2 import simple_spread_v3

def parallel_env():
    return simple_spread_v3.parallel_env(N=3, continuous_actions={continuous})
"""

TOY = """
import numpy as np
from gymnasium.spaces import Box, Discrete, MultiBinary
from pettingzoo import ParallelEnv

class Toy(ParallelEnv):
    metadata = {{"name": "toy"}}
    possible_agents = ["left", "right"]
    seen, done, leaves, reward = {seen}, {done}, {leaves}, {reward}
    def observation_space(self, agent): return self.seen
    def action_space(self, agent): return self.done
    def reset(self, seed=None, options=None):
        {at_reset}
        self.agents, self.count = list(self.possible_agents), 0
        return self.look(), {{name: {{}} for name in self.agents}}
    def look(self): return {{name: {look} for name in self.agents}}
    def step(self, actions):
        {before}
        self.count += 1
        ended = {{name: name in self.leaves for name in self.agents}}
        names = self.agents
        masks = {{name: {{"action_mask": {mask}}} for name in names}}
        no = dict.fromkeys(names, False)
        {instead}
        return self.look(), dict.fromkeys(names, self.reward), ended, no, masks

def parallel_env(): return Toy()
"""
STEP = TOY.splitlines().index("    def step(self, actions):") + 1
SEEN = "    def observation_space(self, agent): return self.seen"


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Writes a module of a name never used before, and says its environment's id."""
    monkeypatch.syspath_prepend(tmp_path)

    def write(text: str) -> str:
        name = f"own_{tmp_path.name.replace('-', '_')}"
        (tmp_path / f"{name}.py").write_text(text)
        return f"{name}:parallel_env"

    return write


def toy(
    seen: str = "Box(-1, 1, (2,))",
    done: str = "Box(-1, 1, (2,))",
    leaves: str = "[]",
    reward: str = "1.0",
    look: str = "np.full(2, self.count, np.float32)",
    mask: str = "np.array([1, self.count % 2, 1])",
    at_reset: str = "",
    before: str = "",
    instead: str = "",
) -> str:
    """The toy's module. `at_reset`, `before` and `instead` are statements of reset and step."""
    return TOY.format(**locals())


def test_an_episode_is_the_environment_s_own(module) -> None:
    env_id = module(SPREAD.format(continuous=True))
    spec = registry.team_spec(env_id)
    assert [(agent.name, agent.observation_size) for agent in spec.agents] == [
        ("agent_0", 18), ("agent_1", 18), ("agent_2", 18)
    ]  # fmt: skip
    assert spec.agents[0].action_low == (0.0,) * 5 and spec.max_episode_steps == 25
    env, random = registry.make(env_id, 2), np.random.default_rng(0)
    env.reset(np.array([0, 1]), np.array([7, 8]))
    for copy, seed in enumerate((7, 8)):
        theirs = simple_spread_v3.parallel_env(N=3, continuous_actions=True)
        seen, _ = theirs.reset(seed=seed)
        env.reset(np.array([0, 1]), np.array([7, 8]))
        for step in range(25):
            np.testing.assert_array_equal(
                [rows[copy] for rows in env.observe()], [seen[name] for name in spec.names]
            )
            actions = [random.random((2, 5), np.float32) for _ in spec.agents]
            outcome = env.step(actions)
            orders = {name: action[copy] for name, action in zip(spec.names, actions, strict=True)}
            seen, rewards, _, cut, _ = theirs.step(orders)
            assert [r[copy] for r in outcome.rewards] == [
                np.float32(rewards[name]) for name in spec.names
            ]
            assert outcome.truncated[copy] == cut["agent_0"] == (step == 24)
            assert not outcome.terminated.any()


def test_the_same_seed_and_actions_give_the_same_bytes(module) -> None:
    env_id = module(SPREAD.format(continuous=False))
    team = registry.team_spec(env_id)
    behaviour = Uniform(team)

    def played() -> list[bytes]:
        rollout = Rollout(registry.make(env_id, 3), 0, "deployment", 1)
        noise = behaviour.noise(np.random.default_rng(0), 40 * 3).reshape(40, 3, -1)
        steps = [
            rollout.advance(behaviour.act(rollout.observations, draw), (False,) * 3)
            for draw in noise
        ]
        return [b"".join(x.tobytes() for x in step.next_observations) for step in steps]

    assert played() == played()


def test_discrete_actions_come_with_their_masks(module) -> None:
    env_id = module(toy(done="Discrete(3, start=4)"))
    env = registry.make(env_id, 1)
    env.reset(np.array([0]), np.array([0]))
    assert env.observe()[0].tolist() == [[0, 0, 1, 1, 1]]
    env.step([np.array([[1.0]], np.float32)] * 2)
    env.step([np.array([[1.0]], np.float32)] * 2)
    assert env.observe()[1].tolist() == [[2, 2, 1, 0, 1]]
    for wrong in (1.0, 0.5, 3.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="left"):
            env.step([np.array([[wrong]], np.float32), np.array([[0.0]], np.float32)])


def test_without_a_limit_of_its_own_an_episode_ends_after_a_thousand_steps(module) -> None:
    env = registry.make(module(toy()), 1)
    env.reset(np.array([0]), np.array([0]))
    still = [np.zeros((1, 2), np.float32)] * 2
    ends = [bool(env.step(still).truncated[0]) for _ in range(1000)]
    assert ends == [False] * 999 + [True]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (toy(seen="MultiBinary(2)"), "only Box and Discrete"),
        (toy(done="Box(-np.inf, np.inf, (1,))"), "must be bounded"),
        ("def parallel_env(): return 3", "is not a PettingZoo ParallelEnv"),
        ("def parallel_env(): 1 / 0", "ZeroDivisionError"),
        ("import no_such_package", "no module no_such_package"),
        ("", "no attribute 'parallel_env'"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(module, text: str, said: str) -> None:
    with pytest.raises(UserError, match=said) as raised:
        registry.team_spec(module(text))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (toy(leaves="['left']"), "left is gone before the episode's end"),
        (
            toy(reward="float('nan')"),
            "the reward of left is nan; it must be finite, also in float32",
        ),
        (toy(reward="None"), "the reward of left is None; it must be a number"),
        (
            toy(instead="return self.look(), 1.0, False, {}"),
            r"step gave \(dict, float, bool, dict\)",
        ),
        (toy(instead="return 3"), r"step gave \(int\); it must give 5 dictionaries"),
        (
            toy(look="np.zeros(2 + (self.count > 0))"),
            r"left observes an array of shape \(3,\), float64; .* an array of shape \(2,\)$",
        ),
        (toy(look="[0.0] * (2 - (self.count > 0))"), r"left observes \[0.0\]; its observation_sp"),
        (toy(look="np.zeros(2) if self.count < 1 else None"), "left observes None; its observ"),
        (
            toy(seen="Discrete(2)", look="3 * self.count"),
            r"left observes 3; its observation_space says Discrete\(2\)$",
        ),
        (
            toy(done="Discrete(3)", mask="np.ones(2, np.int8)"),
            r"the action_mask of left is an array of shape \(2,\), int8; its 3 actions need an"
            r" array of shape \(3,\)$",
        ),
        (toy(done="Discrete(3)", mask="'all'"), "the action_mask of left is 'all'; its 3 actions"),
        (
            toy(done="Discrete(3)", mask="np.zeros(3)"),
            "the action_mask of left is all zero; at least one of its 3 actions must be available",
        ),
    ],
)
def test_what_goes_wrong_while_it_is_played(module, text: str, said: str) -> None:
    env = registry.make(module(text), 1)
    env.reset(np.array([0]), np.array([0]))
    still = [np.zeros((1, agent.action_size), np.float32) for agent in env.spec.agents]
    with pytest.raises(UserError, match=said) as raised:
        env.step(still)
    assert "\n" not in str(raised.value)
    with pytest.raises(UserError, match="cannot be set to a state"):
        env.set_state(env.state())


def test_a_mask_may_be_all_zero_once_the_episode_has_terminated(module) -> None:
    text = toy(done="Discrete(3)", mask="np.zeros(3)", leaves="['left', 'right']")
    env = registry.make(module(text), 1)
    env.reset(np.array([0]), np.array([0]))
    assert env.step([np.zeros((1, 1), np.float32)] * 2).terminated[0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (  # what fails is NumPy's code, but the mistake is where it was called
            toy(before="np.linalg.inv(np.zeros((2, 2)))"),
            f": step raised LinAlgError: Singular matrix (own.py:{STEP + 1})",
        ),
        (
            toy(at_reset="raise ValueError('two\\nlines')"),
            f": reset raised ValueError: two lines (own.py:{STEP - 4})",
        ),
        (
            toy(seen="None").replace("return self.seen", "return self.sight"),
            ": asked for the spaces of left, it raised AttributeError: 'Toy' object has"
            f" no attribute 'sight' (own.py:{TOY.splitlines().index(SEEN) + 1})",
        ),
        ("def parallel_env():\n    raise KeyError", " cannot be made: KeyError (own.py:2)"),
    ],
)
def test_what_it_raises_is_told_with_the_line_of_its_own_code(
    module, tmp_path: Path, text: str, said: str
) -> None:
    env_id = module(text)
    with pytest.raises(UserError) as raised:
        env = registry.make(env_id, 1)
        env.reset(np.array([0]), np.array([0]))
        env.step([np.zeros((1, 2), np.float32)] * 2)
    path = str(tmp_path / env_id.partition(":")[0])
    assert str(raised.value) == env_id + said.replace("own", path)


def test_its_random_data_name_the_module_they_were_made_with(module) -> None:
    env_id = module(SPREAD.format(continuous=True))
    card = store.ensure(f"{env_id}/random", 500)
    assert card.transitions == 500
    assert card.recipe["mpe2"] and card.recipe == {
        **card.recipe, **pettingzoo_adapter.versions(env_id)
    }  # fmt: skip


def launched(folder: Path, text: str, *flags: str) -> subprocess.CompletedProcess[str]:
    """A run of the environment that a module of that text makes."""
    (folder / "my_module.py").write_text(text)
    command = [
        *(sys.executable, "-m", "otc_dist.launch", "navigation", "--out", "run"),
        *("--set", "env.id=my_module:parallel_env", *flags),
    ]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )


@pytest.mark.slow
def test_a_mistake_in_it_is_the_launcher_s_only_complaint(
    tmp_path: Path, cache_folder: Path, tiny_flags: tuple[str, ...]
) -> None:
    ended = launched(tmp_path, toy(before="if self.count > 2: self.nothing"), *tiny_flags)
    assert ended.returncode == 2
    assert ended.stderr.splitlines() == [
        "error: my_module:parallel_env: step raised AttributeError: 'Toy' object has no attribute"
        f" 'nothing' ({tmp_path / 'my_module.py'}:{STEP + 1})"
    ]
    assert "resume with" not in ended.stdout
    assert not (tmp_path / "run").exists()  # fixed, it can be given the same name


@pytest.mark.slow
def test_what_dies_without_a_word_is_named_by_the_launcher(
    tmp_path: Path, cache_folder: Path, tiny_flags: tuple[str, ...]
) -> None:
    ended = launched(tmp_path, toy(before="import os; os._exit(7)"), *tiny_flags)
    assert ended.returncode == 1
    assert ended.stderr.splitlines() == [
        "error: data exited with status 7; all others were stopped"
    ]


@pytest.mark.slow
def test_it_is_tuned_through_the_launcher(
    tmp_path: Path, cache_folder: Path, tiny_flags: tuple[str, ...]
) -> None:
    ended = launched(tmp_path, SPREAD.format(continuous=True), *tiny_flags)
    assert ended.returncode == 0, ended.stderr
    assert "after deployment 2" in ended.stdout
    assert (tmp_path / "run/deployments/deployment_02.mcap").stat().st_size > 0
