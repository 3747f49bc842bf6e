"""A small team whose transition dynamics are known: two agents push a token along a line.

One agent learns; what its partner does makes its transition dynamics. P(s'|s, a) are arrays
(STATES, ACTIONS, STATES), data sets are counts or rows of <s, a, s'> drawn from them.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from otc_dist.otc.acceptance import conformal, share
from otc_dist.otc.acceptance.rank import RankMatched
from otc_dist.otc.data import Data
from otc_dist.otc.distances.value import ValueDistance
from otc_dist.otc.samplers.correction import CorrectionSection
from otc_dist.otc.samplers.interface import Extent
from otc_dist.steps.noise import Noise, NoiseSpec, sample_noise
from otc_dist.steps.state import State
from otc_dist.transitions import RowLayout

Float = NDArray[np.float64]
STATES, ACTIONS, GAMMA = 7, 3, 0.9
WIND = (0.1, 0.2, 0.4, 0.2, 0.1)  # of -2 .. 2
LAYOUT = RowLayout(1, 1)


def kl(p: Float, q: Float) -> Float:
    """KL(p || q) of the last axis, with 0 log 0 = 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(p > 0, p * np.log(p / q), 0.0).sum(-1)


def token(partner: tuple[float, float, float]) -> Float:
    """P(s'|s, a): s' = s + a + 2 b + wind, where the partner pushes b = -1, 0 or 1."""
    dynamics = np.zeros((STATES, ACTIONS, STATES))
    for s, a, b, w in np.ndindex(STATES, ACTIONS, 3, len(WIND)):
        to = np.clip(s + (a - 1) + 2 * (b - 1) + (w - 2), 0, STATES - 1)
        dynamics[s, a, to] += partner[b] * WIND[w]
    return dynamics


OFFLINE = token((0.6, 0.3, 0.1))  # the partner that made the data pushes left,
ONLINE = token((0.1, 0.3, 0.6))  # the one that was learned pushes right


def random_team(random: np.random.Generator, states: int = 5, actions: int = 3) -> Float:
    """P(s'|s, a, b) of a random two-agent task, (states, actions, actions, states)."""
    return random.dirichlet(np.full(states, 0.5), (states, actions, actions))


def seen_by_one(team: Float, partner: Float) -> Float:
    """P(s'|s, a) = sum_b pi(b|s) P(s'|s, a, b), for the partner's policy (states, actions)."""
    return np.einsum("sabt,sb->sat", team, partner)


def corrected(offline: Float, online: Float, accept: Float) -> tuple[Float, Float]:
    """The modified P_B(s'|s, a), and its factor  sum_s^' P_D(s^'|s, a) f(d(s', s^')) / Z(s, a).

    Args:
        accept: f(d(s', s^')) (states, states).
    """
    factor = np.einsum("sau,tu->sat", online, accept)
    z = (offline * factor).sum(-1, keepdims=True)
    return offline * factor / z, factor / z


def optimal_values(dynamics: Float, rewards: Float, gamma: float) -> Float:
    """V* (states,) by policy iteration, exact up to rounding."""
    states = len(dynamics)
    policy = np.zeros(states, np.int64)
    while True:
        chosen = (np.arange(states), policy)
        v = np.linalg.solve(np.eye(states) - gamma * dynamics[chosen], rewards[chosen])
        q = rewards + gamma * dynamics @ v
        if (q.max(1) <= q[chosen] + 1e-12).all():
            return v
        policy = q.argmax(1)


def _values_of_uniform_policy(dynamics: Float) -> Float:
    """Q(s, a) of a reward that grows to the right, by iteration."""
    q = np.zeros((STATES, ACTIONS))
    for _ in range(500):
        q = np.arange(STATES)[:, None] / STATES + GAMMA * dynamics @ q.mean(1)
    return q


Q = _values_of_uniform_policy(OFFLINE)  # what the agent learned offline
DISTANCE = np.abs(Q.mean(1)[:, None] - Q.mean(1)[None, :])  # d(s', s^') by its V


class TabularCritic:
    """Q and V as the sampler asks for them; s and a are numbers of states and actions."""

    def q(self, state: State, observations: Tensor, actions: Tensor) -> Tensor:
        return torch.from_numpy(Q)[observations[:, 0].long(), actions[:, 0].long()]

    def value_noise_spec(self, count: int, samples: int) -> dict[str, NoiseSpec]:
        return {}

    def value(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        return torch.from_numpy(Q.mean(1))[observations[:, 0].long()]


@dataclass(frozen=True)
class Sets:
    """B_0 and D_1 of one agent, D_1 1% of B_0, as rows; (s, a) are uniform in both."""

    rows: NDArray[np.int64]  # (N, 3) s, a, s'; D_1's last
    offline: int

    @classmethod
    def sample(cls, offline: Float, online: Float, seed: int = 0) -> "Sets":
        random = np.random.default_rng(seed)
        parts = []
        for dynamics, count in ((offline, 500_000), (online, 5000)):
            s, a = random.integers(0, STATES, count), random.integers(0, ACTIONS, count)
            past = random.random(count)[:, None] >= dynamics.cumsum(-1)[s, a]
            parts.append(np.stack([s, a, past.sum(1).clip(max=STATES - 1)], 1))
        return cls(np.concatenate(parts), len(parts[0]))


def frequencies(rows: NDArray[np.int64]) -> Float:
    """P(s'|s, a) as it occurs among rows of s, a, s'."""
    counts = np.zeros((STATES, ACTIONS, STATES))
    np.add.at(counts, tuple(rows.T), 1.0)
    return counts / counts.sum(-1, keepdims=True)


def sampled_dynamics(sets: Sets, alpha: float, *, replace: bool, minibatches: int = 1000) -> Float:
    """P(s'|s, a) among what Algorithm 1 selects from B_1 (lines 10 to 14), by the library's own
    sampler with d_q, at Table 3's sizes.
    """
    settings = CorrectionSection(distance="value", normaliser="shared", with_replacement=replace)
    distance = ValueDistance(TabularCritic(), LAYOUT, settings)
    sampler = RankMatched(settings, 128, distance)
    rows = torch.zeros(len(sets.rows), LAYOUT.width)
    rows[:, 0], rows[:, 1], rows[:, 3] = torch.from_numpy(sets.rows).float().T
    data = Data(rows, rows[:, :0], prepared={"alpha": torch.tensor(alpha)})
    extent = Extent(sets.offline, sets.offline, len(sets.rows))
    random, chosen = np.random.default_rng(1), []
    for _ in range(minibatches):
        arrays = {
            **sampler.sample_indices(random, 1, extent),
            **sample_noise(random, sampler.noise_spec(), 1),
        }
        sampled = {name: torch.from_numpy(array[0]) for name, array in arrays.items()}
        chosen.append(sampler.select({}, sampler.gather({}, data, sampled), sampled).rows.numpy())
    return frequencies(sets.rows[np.concatenate(chosen)])


def weighted_dynamics(sets: Sets, acceptance: str) -> Float:
    """P(s'|s, a) in B_1 as `share` or `conformal` weighs it, by how far s' is from what D_1 lets
    expect after (s, a): the squared residual of s' as a one-hot vector, each half of D_1 judged by
    the other's mean.
    """
    rows, offline = sets.rows, sets.offline
    half = np.arange(len(rows)) % 2
    newest = np.arange(len(rows)) >= offline
    judge = np.where(newest, 1 - half, half)
    scores = np.empty(len(rows))
    for fold in (0, 1):
        expected = frequencies(rows[newest & (half == fold)])
        s, a, then = rows[judge == fold].T
        residual = np.eye(STATES)[then] - expected[s, a]
        scores[judge == fold] = (residual**2).sum(-1)
    weigh = {"share": share.weights, "conformal": conformal.weights}[acceptance]
    extent = Extent(offline, offline, len(rows))
    weights = weigh(CorrectionSection(), torch.from_numpy(scores), extent).double().numpy()
    weights[offline:] = 1.0
    counts = np.zeros((STATES, ACTIONS, STATES))
    np.add.at(counts, tuple(rows.T), weights)
    return counts / counts.sum(-1, keepdims=True)


def rank_acceptance(offline: Float, online: Float, alpha: float, candidates: int = 512) -> Float:
    """f(d(s', s^')) that Eq. 3 amounts to, sampled with replacement: the mean of 1/rank^alpha over
    the ranks that a distance takes among `candidates` transitions.
    """
    pairs = np.einsum("sat,sau->tu", offline, online) / (STATES * ACTIONS)
    _, level = np.unique(DISTANCE.round(12), return_inverse=True)
    share = np.bincount(level.ravel(), weights=pairs.ravel())
    ends = np.concatenate([[0], share.cumsum()]) * candidates
    weight = np.concatenate([[0], np.cumsum(np.arange(1, candidates + 1) ** -alpha)])
    below = np.interp(ends, np.arange(candidates + 1), weight)
    return (np.diff(below) / (share * candidates))[level.reshape(DISTANCE.shape)]
