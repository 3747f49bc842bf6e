"""Balanced Replay equals a plain version of modules, autograd, Adam and one running sum."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from benchmarks.plain.parts import mlp, step
from otc_dist.otc.data import Data
from otc_dist.otc.samplers import balanced
from otc_dist.otc.samplers.balanced import Balanced, BalancedSection
from otc_dist.otc.samplers.interface import Extent, Selection
from otc_dist.steps.engine import Engine
from otc_dist.steps.noise import sample_noise
from otc_dist.steps.state import State
from otc_dist.transitions import RowLayout

from ..brains import ARMS, SPEC, online, pretrained, silent, transitions
from ..flat_weights import get_flat, set_flat
from .held import held_by

S, A, BATCH, CAPACITY = 5, 2, 16, 450
LAYOUT = RowLayout(S, A)
FIRST = Extent(offline=300, newest=300, size=340)  # B_0 and D_1
SECOND = Extent(offline=300, newest=340, size=400)  # and D_2; rows beyond are not filled yet


def make(**changes: Any) -> Balanced:
    sizes: dict[str, Any] = {"layout": LAYOUT, "batch_size": BATCH, "capacity": CAPACITY}
    settings: dict[str, Any] = {
        "density_hidden": (16, 8),
        "density_learning_rate": 1e-3,
        "temperature": 5.0,
    }
    for name, value in changes.items():
        (sizes if name in sizes else settings)[name] = value
    return Balanced(BalancedSection(**settings), **sizes)


def held(seed: int = 0) -> Data:
    """Online transitions lie to one side. Rows not filled yet are NaN: nobody may look at them."""
    random = np.random.default_rng(seed)
    rows = random.standard_normal((CAPACITY, LAYOUT.width))
    rows[FIRST.offline :, :2] += 1.5
    rows[SECOND.size :] = np.nan
    return Data(torch.from_numpy(rows), torch.zeros(CAPACITY, 0))


def begun(sampler: Balanced, extent: Extent = FIRST, seed: int = 0) -> State:
    """The state at the first deployment, in float64."""
    ready = held_by({"other": torch.zeros(3)}, held(), extent, np.random.default_rng(seed))
    found = dict(sampler.begin(ready).changed)
    return {name: tensor.double() for name, tensor in found.items()}


def sampled_for(
    sampler: Balanced, random: np.random.Generator, extent: Extent
) -> dict[str, Tensor]:
    arrays = {
        **sampler.sample_indices(random, 1, extent),
        **sample_noise(random, sampler.noise_spec(), 1),
    }
    return {name: torch.from_numpy(array[0]) for name, array in arrays.items()}


def one_update(
    sampler: Balanced, state: State, data: Data, random: np.random.Generator, extent: Extent
) -> tuple[State, Selection]:
    sampled = sampled_for(sampler, random, extent)
    with torch.no_grad():
        selection = sampler.select(state, sampler.gather(state, data, sampled), sampled)
    return {**state, **selection.changed}, selection


class Plain:
    """Balanced Replay, from the equations of its paper and code."""

    def __init__(self, sampler: Balanced, state: State) -> None:
        settings = sampler.settings
        self.network = mlp(S + A, settings.density_hidden, 1, torch.float64)
        set_flat([self.network], state["sampler_density"])
        self.adam = torch.optim.Adam(
            self.network.parameters(), lr=sampler.settings.density_learning_rate
        )
        self.temperature = settings.temperature
        self.priorities = np.zeros(CAPACITY)
        self.priorities[: FIRST.offline] = 1

    def deploy(self, extent: Extent) -> None:
        """Half of the first minibatches are D_k's: as much priority as all the rest has."""
        count = extent.size - extent.newest
        self.priorities[extent.newest : extent.size] = self.rounded(self.priorities.sum() / count)

    def rounded(self, priority: Any) -> Any:
        return np.round(priority * 2**20) / 2**20

    def w(self, rows: Tensor) -> Tensor:
        # softplus(x + log(e - 1)): the authors begin with w = 1, too.
        raw = self.network(rows[:, : S + A])[:, 0]
        return nn.functional.softplus(raw + np.log(np.e - 1))

    def update(self, data: Data, sampled: dict[str, Tensor]) -> list[int]:
        running = np.cumsum(self.priorities)
        noise = sampled["priority"].numpy().astype(np.float64)
        points = (np.arange(BATCH) + noise) / BATCH * running[-1]
        chosen = [int(np.argmax(running > point)) for point in points]

        w_off, w_on = self.w(data.rows[sampled["offline"]]), self.w(data.rows[sampled["online"]])
        loss = (
            -torch.log(2 / (w_off + 1) + 1e-10) - torch.log(2 * w_on / (w_on + 1) + 1e-10)
        ).mean()
        with torch.no_grad():
            powers = self.w(data.rows[chosen]) ** (1 / self.temperature)
            normalised = powers / ((w_off ** (1 / self.temperature)).mean() + 1e-10)
        self.priorities[chosen] = self.rounded(normalised.clamp(0.001, 1000).numpy())
        step(self.adam, loss)
        return chosen


def test_weights_draws_and_priorities_equal_the_plain_version_in_float64() -> None:
    sampler, data, random = make(), held(), np.random.default_rng(0)
    state = begun(sampler)
    plain = Plain(sampler, state)
    plain.deploy(FIRST)
    for update in range(130):
        extent = FIRST if update < 70 else SECOND
        if update == 70:  # the second deployment
            state = {**state, **sampler.begin(held_by(state, held(), SECOND, random)).changed}
            plain.deploy(SECOND)
        sampled = sampled_for(sampler, random, extent)
        with torch.no_grad():
            selection = sampler.select(state, sampler.gather(state, data, sampled), sampled)
        state = {**state, **selection.changed}
        assert selection.rows.tolist() == plain.update(data, sampled)
        weights = get_flat([plain.network])
        np.testing.assert_allclose(state["sampler_density"], weights, atol=1e-10)
        priorities = state["sampler_priorities"].view(-1)[:CAPACITY]
        np.testing.assert_allclose(priorities, plain.priorities, atol=1e-10)
    assert state["sampler_updates"] == 130
    assert len(set(plain.priorities[:300])) > 200  # most have been drawn and changed


def test_w_becomes_the_ratio_of_the_densities() -> None:
    """Gaussians of equal width, 1 apart in the first entry of s: log w = s_0 - 1/2."""
    random = np.random.default_rng(0)
    count = 20_000
    rows = random.standard_normal((count, LAYOUT.width))
    rows[count // 2 :, 0] += 1
    data = Data(torch.from_numpy(rows), torch.zeros(count, 0))
    extent = Extent(offline=count // 2, newest=count // 2, size=count)
    sampler = make(capacity=count, batch_size=256, density_learning_rate=3e-3)
    state = begun(sampler, extent)
    for _ in range(300):
        state, _ = one_update(sampler, state, data, random, extent)
    with torch.no_grad():
        found = sampler.ratio(state["sampler_density"], data.rows).log()
    near = data.rows[:, 0].sub(0.5).abs() < 1  # where both have data
    error = (found - (data.rows[:, 0] - 0.5))[near]
    assert error.abs().mean() < 0.15
    assert error.mean().abs() < 0.1
    priorities = state["sampler_priorities"].view(-1)[: extent.offline]
    drawn = priorities != 1
    w = found[: extent.offline][drawn].exp() ** 0.2
    assert np.corrcoef(priorities[drawn], w)[0, 1] > 0.9


@pytest.mark.parametrize("extent", [FIRST, FIRST._replace(size=302), FIRST._replace(size=440)])
def test_the_newest_data_are_half_of_the_first_minibatch(extent: Extent) -> None:
    sampler, random = make(batch_size=64), np.random.default_rng(0)
    state = begun(sampler, extent)
    per_row = state["sampler_priorities"].view(-1)
    assert (per_row[:300] == 1).all()
    authors = balanced.ONLINE_SHARE * 300 / ((1 - balanced.ONLINE_SHARE) * (extent.size - 300))
    assert float(per_row[300]) == pytest.approx(authors, abs=1e-6)
    assert (per_row[extent.size :] == 0).all()
    rows = sampler.gather(state, held(), sampled_for(sampler, random, extent))["numbers"]
    assert int((rows >= 300).sum()) == 32


def test_a_later_deployment_gets_the_same_share() -> None:
    sampler, data, random = make(batch_size=64), held(), np.random.default_rng(0)
    state = begun(sampler)
    for _ in range(40):
        state, _ = one_update(sampler, state, data, random, FIRST)
    before = state["sampler_priorities"].clone()
    state = {**state, **sampler.begin(held_by(state, held(), SECOND, random)).changed}
    rows = sampler.gather(state, data, sampled_for(sampler, random, SECOND))["numbers"]
    assert abs(int((rows >= SECOND.newest).sum()) - 32) <= 1
    kept = state["sampler_priorities"].view(-1)[: SECOND.newest]
    assert torch.equal(kept, before.view(-1)[: SECOND.newest])


def test_the_newest_data_give_way_once_they_have_been_drawn() -> None:
    sampler, data, random = make(), held(), np.random.default_rng(0)
    state, shares = begun(sampler), []
    for _ in range(60):
        state, selection = one_update(sampler, state, data, random, FIRST)
        shares.append(float((selection.rows >= FIRST.newest).float().mean()))
    assert np.mean(shares[:3]) > 0.35
    assert np.mean(shares[-20:]) < 0.25


def test_rows_not_filled_yet_are_never_drawn() -> None:
    sampler, data, random = make(), held(), np.random.default_rng(0)
    state = begun(sampler)
    for _ in range(50):
        state, selection = one_update(sampler, state, data, random, FIRST)
        assert int(selection.rows.max()) < FIRST.size


def test_nan_never_enters_the_priorities() -> None:
    sampler, random = make(), np.random.default_rng(0)
    for broken in (torch.nan, torch.inf, 1e300):
        state = begun(sampler)
        state["sampler_density"] = torch.full_like(state["sampler_density"], broken)
        for _ in range(3):
            state, _ = one_update(sampler, state, held(), random, FIRST)
            assert torch.isfinite(state["sampler_priorities"]).all()
            assert torch.equal(state["sampler_sums"], state["sampler_priorities"].sum(1))
    state = begun(sampler)
    state["sampler_density"] = torch.full_like(state["sampler_density"], -1e4)  # w is 0
    after, selection = one_update(sampler, state, held(), random, FIRST)
    assert (after["sampler_priorities"].view(-1)[selection.rows] >= 1e-3 - 1e-6).all()
    assert torch.isfinite(after["sampler_density"]).all()


def test_choosing_leaves_its_arguments_alone() -> None:
    sampler, random = make(), np.random.default_rng(0)
    state = begun(sampler)
    before = {name: tensor.clone() for name, tensor in state.items()}
    after, _ = one_update(sampler, state, held(), random, FIRST)
    sampler.begin(held_by(state, held(), SECOND, random))
    for name, tensor in before.items():
        assert torch.equal(state[name], tensor), name
        assert not torch.equal(after[name], tensor), name


def test_a_discrete_action_is_one_of_many_and_no_number() -> None:
    layout = RowLayout(S, 1, choices=3)
    sampler = make(layout=layout)
    rows = torch.zeros(3, layout.width).double()
    rows[:, layout.action] = torch.arange(3).double().unsqueeze(1)
    state = begun(sampler)
    assert sampler.density.inputs == (S, 3)
    with torch.no_grad():
        w = sampler.ratio(state["sampler_density"], rows)
        columns = sampler.density.apply(
            state["sampler_density"], torch.zeros(3, S).double(), torch.eye(3).double()
        )
    expected = nn.functional.softplus(columns[:, 0] + np.log(np.e - 1))
    np.testing.assert_allclose(w, expected, rtol=1e-12)
    assert len(set(w.tolist())) == 3


def test_states_of_the_same_key_are_the_same() -> None:
    one, two, other = (begun(make(), seed=seed) for seed in (1, 1, 2))
    assert all(torch.equal(one[name], two[name]) for name in one)
    assert not torch.equal(one["sampler_density"], other["sampler_density"])


def test_settings_of_otc_do_not_matter() -> None:
    digests = set()
    for change in ("alpha=1.0", "alpha=7.5", "adaptive=false", "distance=value", "candidates=300"):
        learner = pretrained(*ARMS["balanced"], f"sampling.{change}")
        learner.tune(1, online(1), silent)
        digests.add(learner.policy_digest())
    assert len(digests) == 1
    learner = pretrained(*ARMS["balanced"], "sampling.temperature=1.0")
    learner.tune(1, online(1), silent)
    assert learner.policy_digest() not in digests


def test_another_agent_changes_nothing() -> None:
    digests = []
    for other in (None, 7, 8):  # the other agent's data
        learner = pretrained(*ARMS["balanced"])
        if other:
            spec = replace(SPEC, name="agent_1")
            colleague = pretrained(*ARMS["balanced"], spec=spec, data=transitions(other, 200))
            colleague.tune(1, online(other), silent)
        learner.tune(1, online(1), silent)
        digests.append(learner.policy_digest())
    assert len(set(digests)) == 1


@pytest.mark.slow
def test_compiled_equals_eager() -> None:
    """In float32: the same rows, since sums of priorities are exact, and weights to rounding."""
    sampler, rows = make(), held().rows.float().nan_to_num()
    data = Data(rows, torch.zeros(CAPACITY, 0))
    ends = []
    for name in ("eager", "compiled"):
        select, random = Engine(name).fuse(sampler.select), np.random.default_rng(0)
        state, chosen = {**sampler.begin(held_by({"other": rows}, data, FIRST, random)).changed}, []
        for _ in range(30):
            sampled = sampled_for(sampler, random, FIRST)
            selection = select(state, sampler.gather(state, data, sampled), sampled)
            state = {**state, **selection.changed}
            chosen.append(selection.rows.tolist())
        ends.append((chosen, state))
    (rows_eager, eager), (rows_compiled, compiled) = ends
    assert rows_eager == rows_compiled
    for key, tensor in eager.items():
        np.testing.assert_allclose(compiled[key], tensor, atol=1e-4)
    np.testing.assert_allclose(compiled["sampler_density"], eager["sampler_density"], atol=1e-6)
