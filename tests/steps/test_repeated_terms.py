"""What is computed twice is computed once, and nothing else changes."""

import torch
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx

from otc_dist.steps.repeated_terms import RepeatedTerms

aten = torch.ops.aten


def losses(weight: Tensor, rows: Tensor) -> tuple[Tensor, ...]:
    """Two losses that ask for the same, one for nearly the same, and numbers drawn twice."""
    first = torch.relu(rows @ weight.split(2)[0])
    second = torch.relu(rows @ weight.split(2)[0])
    other = torch.relu(rows @ weight.split(2)[1])
    drawn = torch.rand(3) - torch.rand(3)
    return first.sum(), second.mean(), other.sum(), drawn, rows + 1, rows + 1


def test_equal_operations_on_equal_values_become_one() -> None:
    weight, rows = torch.randn(4, 5), torch.randn(7, 2)
    traced = make_fx(losses, tracing_mode="fake")(weight, rows)
    RepeatedTerms()(traced.graph)
    traced.graph.eliminate_dead_code()
    traced.graph.lint()
    counts = {
        target: len(traced.graph.find_nodes(op="call_function", target=target))
        for target in (aten.mm.default, aten.relu.default, aten.rand.default, aten.add.Tensor)
    }
    # Numbers drawn are never the same; what is returned twice are two tensors.
    assert counts == {
        aten.mm.default: 2,
        aten.relu.default: 2,
        aten.rand.default: 2,
        aten.add.Tensor: 2,
    }
    traced.recompile()
    found, wanted = traced(weight, rows), losses(weight, rows)
    assert all(map(torch.equal, found[:3], wanted[:3])) and found[3].any()
    assert found[4] is not found[5]
