import itertools

import numpy as np
import pytest

from otc_dist.envs import registry
from otc_dist.envs.base import Outcome
from otc_dist.envs.rollout import Rollout
from otc_dist.spec import AgentSpec, TeamSpec

EXPLORING = (True, True, False)


def _play(seed, phase, deployment, copies=4, steps=120):
    """Hopper by fixed pseudo-random actions: (rollout, its joint steps)."""
    env = registry.make("hopper-3x1", copies)
    rollout = Rollout(env, seed, phase, deployment)
    rng = np.random.default_rng(0)
    taken = []
    for _ in range(steps):
        noise = rng.uniform(-1, 1, (3, 64, 1)).astype(np.float32)  # as much for any E
        taken.append(rollout.advance(list(noise[:, :copies]), EXPLORING))
    return rollout, taken


def _same(ours, theirs):
    for left, right in zip(ours, theirs, strict=True):
        assert left.step == right.step
        for name in ("observations", "actions", "rewards", "next_observations"):
            for x, y in zip(getattr(left, name), getattr(right, name), strict=True):
                np.testing.assert_array_equal(x, y)
        for name in ("terminated", "truncated", "episode_seeds", "state"):
            np.testing.assert_array_equal(getattr(left, name), getattr(right, name))


def test_same_key_same_bytes():
    (first, ours), (second, theirs) = _play(3, "deployment", 2), _play(3, "deployment", 2)
    _same(ours, theirs)
    assert first.episodes == second.episodes
    assert len(first.episodes) > 4


def test_deployments_differ_and_evaluations_share_their_episodes():
    def seeds(phase, deployment):
        return _play(3, phase, deployment, steps=1)[1][0].episode_seeds.tolist()

    assert seeds("deployment", 1) != seeds("deployment", 2)
    assert seeds("evaluation", 1) == seeds("evaluation", 2)
    assert seeds("evaluation", 1) != seeds("deployment", 1)
    assert len(set(seeds("evaluation", 1))) == 4


def test_a_copy_plays_the_same_whatever_the_number_of_copies():
    _, few = _play(3, "deployment", 0, copies=2)
    _, many = _play(3, "deployment", 0, copies=7)
    for left, right in zip(few, many, strict=True):
        np.testing.assert_array_equal(left.state, right.state[:2])
        np.testing.assert_array_equal(left.rewards[0], right.rewards[0][:2])


def test_successors_are_true_and_ended_copies_start_anew():
    _, steps = _play(3, "deployment", 0)
    env = registry.make("hopper-3x1", 4)
    restarts = 0
    for now, then in itertools.pairwise(steps):
        env.set_state(now.state)
        np.testing.assert_array_equal(env.observe()[0], now.observations[0])
        env.step(now.actions)
        np.testing.assert_array_equal(env.observe()[0], now.next_observations[0])
        ended = now.terminated | now.truncated
        for copy in range(4):
            follows = np.array_equal(then.observations[0][copy], now.next_observations[0][copy])
            assert follows != ended[copy]
            assert (then.episode_seeds[copy] == now.episode_seeds[copy]) != ended[copy]
            assert (then.state[copy, 0] == 0) == ended[copy]  # elapsed steps
        restarts += int(ended.sum())
    assert restarts > 4


def test_returns_and_lengths_are_those_of_the_steps():
    rollout, steps = _play(3, "deployment", 0)
    totals, lengths, expected = np.zeros(4), np.zeros(4, int), []
    for joint in steps:
        totals += joint.rewards[0]
        lengths += 1
        for copy in np.flatnonzero(joint.terminated | joint.truncated):
            expected.append((totals[copy], lengths[copy]))
            totals[copy], lengths[copy] = 0.0, 0
    assert rollout.episode_returns == pytest.approx([x for x, _ in expected])
    assert list(rollout.episode_lengths) == [n for _, n in expected]


def test_evaluation_counts_one_episode_a_copy_in_the_order_of_copies():
    rollout, _ = _play(3, "evaluation", 0, copies=6, steps=1)
    assert not rollout.finished
    rollout, _ = _play(3, "evaluation", 0, copies=6, steps=300)
    assert rollout.finished
    assert [episode.copy for episode in rollout.episodes] == list(range(6))
    assert all(episode.number == 0 for episode in rollout.episodes)


def test_few_copies_count_as_many_episodes_each_as_was_settled_beforehand():
    def play(copies, episodes):
        rollout = Rollout(registry.make("hopper-3x1", copies), 3, "evaluation", 0, episodes)
        noise = np.random.default_rng(0)
        while not rollout.finished:
            sent = noise.uniform(-1, 1, (3, copies, 1)).astype(np.float32)
            rollout.advance(list(sent), EXPLORING)
        return rollout.episodes

    episodes = play(3, 7)
    assert [(one.copy, one.number) for one in episodes] == [
        (0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (2, 0), (2, 1)
    ]  # fmt: skip
    assert len({one.seed for one in episodes}) == 7
    assert play(4, 4) == play(4, None)


class _Scripted:
    """Two copies of a game of three steps that is won on odd seeds, and breaks off on `broken`."""

    def __init__(self, broken=()):
        agent = AgentSpec("agent_0", 1, (-1.0,), (1.0,))
        self.spec, self.copies = TeamSpec("scripted", (agent,), 1, 3), 2
        self._broken, self._seeds, self._time = broken, np.zeros(2, np.int64), np.zeros(2)
        self.started = []

    def reset(self, which, seeds):
        self._seeds[which], self._time[which] = seeds, 0
        self.started += zip(which.tolist(), seeds.tolist(), strict=True)

    def observe(self):
        return (self._time[:, None].astype(np.float32),)

    def state(self):
        return self._time[:, None].copy()

    def step(self, actions):
        self._time += 1
        broken = np.array([len(self.started) - 1 in self._broken] * 2) & (self._time == 2)
        ended = self._time == 3
        self.success = ended & (self._seeds % 2 == 1)
        return Outcome((np.ones(2, np.float32),), ended | broken, broken)


def _scripted(phase, steps, broken=()):
    env = _Scripted(broken)
    rollout = Rollout(env, 0, phase, 1)
    for _ in range(steps):
        rollout.advance([np.zeros((2, 1), np.float32)], (False,))
    return rollout, [seed for _, seed in env.started]


@pytest.mark.parametrize("phase", ["deployment", "evaluation"])
def test_episodes_are_won_or_lost_where_the_task_says_so(phase):
    rollout, seeds = _scripted(phase, 6)
    assert rollout.successes == tuple(seed % 2 == 1 for seed in seeds[: len(rollout.episodes)])
    assert [episode.success for episode in rollout.episodes] == list(rollout.successes)
    hopper, _ = _play(3, "deployment", 0)
    assert hopper.successes is None
    assert hopper.episodes[0].success is None


def test_an_episode_that_the_simulator_broke_off_does_not_count():
    # Both copies break off in their second step; then each starts another episode.
    rollout, seeds = _scripted("evaluation", 4, broken={1})
    assert not rollout.finished
    assert rollout.episodes == ()
    rollout, seeds = _scripted("evaluation", 5, broken={1})
    assert rollout.finished
    assert [(one.number, one.length, one.team_return) for one in rollout.episodes] == [
        (1, 3, 3)
    ] * 2
    assert rollout.successes == tuple(seed % 2 == 1 for seed in seeds[2:4])
    assert rollout.episode_seeds == tuple(seeds[2:4])


def test_steps_keep_the_actions_as_sent():
    rollout = Rollout(registry.make("hopper-3x1", 1), 0, "deployment", 0)
    sent = [np.full((1, 1), 3.0, np.float32) for _ in range(3)]
    step = rollout.advance(sent, EXPLORING)
    sent[0][:] = 0.0
    assert step.actions[0] == 3.0
    assert step.exploring == EXPLORING


def test_a_refused_action_leaves_the_rollout_as_it_was():
    rollout = Rollout(registry.make("hopper-3x1", 1), 0, "deployment", 0)
    with pytest.raises(ValueError, match="not finite"):
        rollout.advance([np.full((1, 1), np.nan, np.float32)] * 3, EXPLORING)
    assert rollout.step == 0
    fresh = Rollout(registry.make("hopper-3x1", 1), 0, "deployment", 0)
    actions = [np.full((1, 1), 0.5, np.float32)] * 3
    _same([rollout.advance(actions, EXPLORING)], [fresh.advance(actions, EXPLORING)])
