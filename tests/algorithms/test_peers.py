"""The algorithms beside d3rlpy's, in float64: same weights, same batches, same noise.

Where d3rlpy departs from an algorithm's source, the test says how and which is right, and
compares the rest.
"""

import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from otc_dist.algorithms.awac import Awac, AwacSection
from otc_dist.algorithms.bcq import Bcq, BcqSection
from otc_dist.algorithms.cql import Cql, CqlSection
from otc_dist.algorithms.critics import td_target
from otc_dist.algorithms.discrete_cql import DiscreteCql, DiscreteCqlSection
from otc_dist.algorithms.interface import Batch
from otc_dist.algorithms.td3bc import Td3Bc, Td3BcSection
from otc_dist.steps.networks import Mlp
from otc_dist.steps.noise import sample_noise
from otc_dist.steps.state import State

from .arrays import double, first, random_batch, random_choices

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    d3rlpy = pytest.importorskip("d3rlpy", reason="d3rlpy, a peer, is not installed")

S, A, BATCH, UPDATES = 5, 2, 16, 40
HIDDEN = (16, 12)
ROUNDED = 1e-6  # d3rlpy sums the critics' losses in float32; their gradients stay in float64
ACTOR_RATE, CRITIC_RATE = 3e-4, 5e-4
USUAL: dict[str, Any] = {"hidden": HIDDEN, "discount": 0.99}
RATES: dict[str, Any] = {"actor_learning_rate": ACTOR_RATE, "critic_learning_rate": CRITIC_RATE}


class Peer:
    """One of d3rlpy's algorithms with the weights of ours, in float64.

    `networks` are triples: modules of theirs (twins together), the shape of ours, and the flat
    weights' key and slice in our state.
    """

    def __init__(self, name: str, actions: int, **settings: Any) -> None:
        encoder = d3rlpy.models.VectorEncoderFactory(list(HIDDEN))
        config = getattr(d3rlpy.algos, f"{name}Config")
        encoders = {
            key: encoder for key in config.__dataclass_fields__ if key.endswith("encoder_factory")
        }
        algorithm = config(batch_size=BATCH, **encoders, **settings).create("cpu:0")
        algorithm.create_impl((S,), actions)
        self.impl = algorithm.impl
        self.modules = self.impl.modules
        for module in vars(self.modules).values():
            if isinstance(module, nn.Module):
                module.double()

    def pairs(
        self, networks: Sequence[nn.Module], mlp: Mlp, flat: Tensor
    ) -> Iterator[tuple[Tensor, Tensor]]:
        """Their parameters beside ours, weight by weight. Two heads of theirs are one of ours."""
        layers = mlp._split(flat)
        for copy, network in enumerate(networks):
            linears = [module for module in network.modules() if isinstance(module, nn.Linear)]
            heads = len(linears) - len(layers) + 1
            shares = [((weight[copy],), (bias[copy],)) for weight, bias in layers[:-1]]
            weight, bias = layers[-1]
            shares.append((weight[copy].chunk(heads, 1), bias[copy].chunk(heads)))
            flattened = [(w, b) for ws, bs in shares for w, b in zip(ws, bs, strict=True)]
            for linear, (w, b) in zip(linears, flattened, strict=True):
                yield linear.weight.data, w.t()
                yield linear.bias.data, b

    def take(self, networks: Sequence[nn.Module], mlp: Mlp, flat: Tensor) -> None:
        for theirs, mine in self.pairs(networks, mlp, flat):
            theirs.copy_(mine)

    def assert_equal(self, networks: Sequence[nn.Module], mlp: Mlp, flat: Tensor) -> None:
        for theirs, mine in self.pairs(networks, mlp, flat):
            torch.testing.assert_close(theirs, mine, rtol=0, atol=1e-10)

    def batch(self, batch: Batch) -> Any:
        s, a, r, next_s, done = batch
        column = r.unsqueeze(1)
        return d3rlpy.torch_utility.TorchMiniBatch(
            observations=s,
            actions=a,
            rewards=column,
            next_observations=next_s,
            next_actions=a,
            returns_to_go=column,
            terminals=done.unsqueeze(1),
            intervals=torch.ones_like(column),
            device="cpu",
        )


class Noise:
    """Hands out tensors where d3rlpy and torch.distributions draw standard normal ones."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._left: list[Tensor] = []
        monkeypatch.setattr(torch, "randn", self._next)
        monkeypatch.setattr("torch.distributions.normal._standard_normal", self._next)

    def will_be(self, *tensors: Tensor) -> None:
        assert not self._left
        self._left = list(tensors)

    def _next(self, *shape: Any, **kind: Any) -> Tensor:
        sizes = shape[0] if len(shape) == 1 else shape
        noise = self._left.pop(0)
        assert noise.shape == torch.Size(sizes)
        return noise


@pytest.fixture
def noise(monkeypatch: pytest.MonkeyPatch) -> Noise:
    return Noise(monkeypatch)


def start(algorithm: Any, make: Any = random_batch, actions: int = A) -> State:
    """A state whose targets differ from their networks."""
    random = np.random.default_rng(0)
    batch = make(random, S, actions, BATCH)
    state, other = (double(algorithm.initial_state(random, batch)) for _ in range(2))
    targets = {key: other[key.removesuffix("_target")] for key in state if key.endswith("_target")}
    return {**state, **targets}


def sampled_for(random: np.random.Generator, algorithm: Any) -> dict[str, Tensor]:
    return first(sample_noise(random, algorithm.noise_spec(BATCH), 1))


def test_bcq(noise: Noise) -> None:
    """Losses and weights for 40 updates.

    d3rlpy's decoder leaves out the tanh that the authors' code ends with (its flag says the
    opposite of what it does), so its actions are not bounded: the tanh is put back here.
    """
    bcq = Bcq(S, A, BcqSection(
        **USUAL, **RATES, vae_learning_rate=1e-3, target_rate=0.05,
        target_candidates=5, acting_candidates=7, perturbation=0.05, soft_minimum=0.75,
    ))  # fmt: skip
    peer = Peer(
        "BCQ", A, actor_learning_rate=ACTOR_RATE, critic_learning_rate=CRITIC_RATE,
        imitator_learning_rate=1e-3, tau=0.05, n_action_samples=5,
    )  # fmt: skip
    modules = peer.modules
    state = start(bcq)

    def networks(state: State) -> list[tuple[Sequence[nn.Module], Mlp, Tensor]]:
        return [
            ([modules.vae_encoder], bcq.encoder, state["vae"][: bcq.encoder.size]),
            ([modules.vae_decoder], bcq.decoder, state["vae"][bcq.encoder.size :]),
            ([modules.policy], bcq.actor, state["actor"]),
            ([modules.targ_policy], bcq.actor, state["actor_target"]),
            (modules.q_funcs, bcq.critics.network, state["critic"]),
            (modules.targ_q_funcs, bcq.critics.network, state["critic_target"]),
        ]

    for network in networks(state):
        peer.take(*network)
    modules.vae_decoder._fc = nn.Sequential(modules.vae_decoder._fc, nn.Tanh())
    random = np.random.default_rng(1)
    for count in range(1, UPDATES + 1):
        batch, sampled = random_batch(random, S, A, BATCH), sampled_for(random, bcq)
        noise.will_be(sampled["vae"], sampled["target"].flatten(0, 1), sampled["actor"])
        losses = peer.impl.update(peer.batch(batch), count)
        state, metrics = bcq.update(state, batch, batch, sampled)
        expected = [losses[key] for key in ("vae_loss", "critic_loss", "actor_loss")]
        np.testing.assert_allclose(metrics[:3].numpy(), expected, rtol=ROUNDED)
    for network in networks(state):
        peer.assert_equal(*network)


def test_td3bc(noise: Noise) -> None:
    """Losses and weights for 40 updates, on states that both find normalised."""
    td3bc = Td3Bc(S, A, Td3BcSection(**USUAL, **RATES, target_rate=0.05, q_weight=2.5))
    peer = Peer(
        "TD3PlusBC", A, actor_learning_rate=ACTOR_RATE, critic_learning_rate=CRITIC_RATE, tau=0.05
    )
    modules = peer.modules
    state = start(td3bc)
    state["state_mean"], state["state_std"] = torch.zeros(S).double(), torch.ones(S).double()

    def networks(state: State) -> list[tuple[Sequence[nn.Module], Mlp, Tensor]]:
        return [
            ([modules.policy], td3bc.actor, state["actor"]),
            ([modules.targ_policy], td3bc.actor, state["actor_target"]),
            (modules.q_funcs, td3bc.critics.network, state["critic"]),
            (modules.targ_q_funcs, td3bc.critics.network, state["critic_target"]),
        ]

    for network in networks(state):
        peer.take(*network)
    random = np.random.default_rng(1)
    for count in range(1, UPDATES + 1):
        batch, sampled = random_batch(random, S, A, BATCH), sampled_for(random, td3bc)
        noise.will_be(sampled["target"])
        losses = peer.impl.update(peer.batch(batch), count)
        state, metrics = td3bc.update(state, batch, batch, sampled)
        # Ours counts the actor's loss twice every other update.
        expected = [losses["critic_loss"], 2 * losses.get("actor_loss", 0.0)]
        np.testing.assert_allclose(metrics[:2].numpy(), expected, rtol=ROUNDED)
    for network in networks(state):
        peer.assert_equal(*network)


def test_awac(noise: Noise) -> None:
    """The critics' loss for a given target, and the actor's, with its advantages and weights.

    Not the target: d3rlpy inherits SAC's, with samples squashed by tanh once more and an entropy
    term at temperature 1. The authors' code (rlkit) takes the policy's own samples, and in its
    settings for AWAC the temperature is 0. d3rlpy's actor has a sum over the batch for a loss, the
    authors' a mean.
    """
    awac = Awac(
        S, A, AwacSection(**USUAL, **RATES, target_rate=0.05, weighting="softmax", temperature=0.03)
    )
    peer = Peer("AWAC", A, lam=0.03)
    modules = peer.modules
    state = start(awac)
    state["actor"][-A:] = torch.tensor([1.0, -0.5])
    peer.take([modules.policy], awac.actor, state["actor"][: awac.actor.size])
    modules.policy._logstd.data.copy_(state["actor"][-A:])
    peer.take(modules.q_funcs, awac.critics.network, state["critic"])

    random = np.random.default_rng(1)
    batch, sampled = random_batch(random, S, A, BATCH), sampled_for(random, awac)
    theirs = peer.batch(batch)
    values = torch.from_numpy(random.standard_normal(BATCH))
    critic_loss = peer.impl.compute_critic_loss(theirs, values.unsqueeze(1)).critic_loss
    target = td_target(batch, 0.99, values)
    mine = awac.critics.loss(state["critic"], batch, target)
    torch.testing.assert_close(mine, critic_loss.double(), rtol=ROUNDED, atol=0)

    noise.will_be(sampled["actor"].unsqueeze(0))
    actor_loss = peer.impl.compute_actor_loss(theirs, modules.policy(batch.observation)).actor_loss
    weights = awac.weights(awac.advantages(state, batch, sampled["actor"]))
    assert weights.std() > 0.1
    torch.testing.assert_close(awac.actor_loss(state["actor"], batch, weights), actor_loss / BATCH)


def test_cql(noise: Noise, monkeypatch: pytest.MonkeyPatch) -> None:
    """The critics' loss for a given target, with its conservative term, and the actor's loss.

    Not the target: without entropy d3rlpy takes the policy's mean in s', where the authors' code
    takes a sample of it. Nor the temperature's loss, which is of the temperature in d3rlpy and of
    its logarithm in the authors' code; the sign of the gradient is the same.
    """
    cql = Cql(S, A, CqlSection(**USUAL, **RATES, target_rate=0.05, weight=5.0, action_samples=6))
    peer = Peer(
        "CQL", A, conservative_weight=5.0, n_action_samples=6, alpha_learning_rate=0.0,
        alpha_threshold=0.0, initial_temperature=0.7, temp_learning_rate=0.0,
    )  # fmt: skip
    modules = peer.modules
    state = start(cql)
    peer.take([modules.policy], cql.actor, state["actor"])
    peer.take(modules.q_funcs, cql.critics.network, state["critic"])

    random = np.random.default_rng(1)
    batch, sampled = random_batch(random, S, A, BATCH), sampled_for(random, cql)
    theirs = peer.batch(batch)
    values = torch.from_numpy(random.standard_normal(BATCH))
    monkeypatch.setattr(
        torch.Tensor,
        "uniform_",
        lambda tensor, low, high: tensor + low + (high - low) * sampled["random"].flatten(0, 1),
    )
    noise.will_be(sampled["current"].transpose(0, 1), sampled["next"].transpose(0, 1))
    critic_loss = peer.impl.compute_critic_loss(theirs, values.unsqueeze(1)).critic_loss
    here = cql.policy(state["actor"], batch.observation)
    there = cql.policy(state["actor"], batch.next_observation)
    mine = cql.critic_loss(
        state["critic"],
        batch,
        td_target(batch, 0.99, values),
        *cql.candidates(here, there, sampled),
    )
    torch.testing.assert_close(mine, critic_loss, rtol=ROUNDED, atol=0)

    noise.will_be(sampled["actor"])
    actor_loss = peer.impl.compute_actor_loss(theirs, modules.policy(batch.observation)).actor_loss
    mine = cql.actor_loss(
        state["actor"],
        state["critic"],
        torch.tensor(0.7).double(),
        batch.observation,
        sampled["actor"],
    )
    torch.testing.assert_close(mine, actor_loss)


def test_discrete_cql() -> None:
    """Losses and weights for 40 updates, with the target copied at every one.

    All actions are available: d3rlpy has no masks.
    """
    choices = 3
    cql = DiscreteCql(
        S,
        choices,
        DiscreteCqlSection(**USUAL, critic_learning_rate=CRITIC_RATE, target_rate=1.0, weight=1.0),
    )
    peer = Peer("DiscreteCQL", choices, learning_rate=CRITIC_RATE, target_update_interval=1)
    modules = peer.modules
    state = start(cql, random_choices, choices)
    peer.take(modules.q_funcs, cql.critic, state["critic"])
    peer.take(modules.targ_q_funcs, cql.critic, state["critic_target"])
    random = np.random.default_rng(1)
    for count in range(1, UPDATES + 1):
        batch = random_choices(random, S, choices, BATCH)
        for states in (batch.observation, batch.next_observation):
            states[:, -choices:] = 1
        losses = peer.impl.update(peer.batch(batch), count)
        state, metrics = cql.update(state, batch, batch, {})
        np.testing.assert_allclose(float(metrics[0]), losses["loss"], rtol=ROUNDED)
    peer.assert_equal(modules.q_funcs, cql.critic, state["critic"])
