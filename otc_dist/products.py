"""Large matrix products by oneDNN, in code that torch compiles for the CPU.

torch computes float32 products by MKL, which leaves half of an AMD processor's vector width
unused. oneDNN, which torch brings for convolutions, uses all of it. Results differ by rounding.
"""

from typing import Any

import torch
from torch import Tensor
from torch._inductor import ir
from torch._inductor.custom_graph_pass import CustomGraphPass, get_hash_for_files
from torch._inductor.lowering import permute, register_lowering
from torch._inductor.mkldnn_ir import LinearUnary
from torch.fx import Graph, Node
from torch.fx.node import map_arg

LEAST = 2**20  # multiplications of two matrices from which oneDNN is the faster
MOST = 8  # products in a batch, each of which is computed by itself
aten = torch.ops.aten


@torch.library.custom_op("otc_dist::product", mutates_args=())
def product(left: Tensor, right: Tensor) -> Tensor:
    """(m, k) times (k, n)."""
    found: Tensor = torch.ops.mkldnn._linear_pointwise(left, right.t(), None, "none", [], "")
    return found


@product.register_fake
def _(left: Tensor, right: Tensor) -> Tensor:
    return left.new_empty((left.shape[0], right.shape[1]))


class _Product(LinearUnary):
    """The compiler's call of oneDNN, but for a weight that is no constant and may be transposed."""

    @classmethod
    def create(cls, left: Any, right: Any) -> ir.TensorBox:  # type: ignore[override]
        left = cls.require_contiguous(cls.realize_input(left))
        right = cls.require_stride1(cls.realize_input(permute(right, [1, 0])))
        rows, columns = left.get_size()[0], right.get_size()[0]
        layout = ir.FixedLayout(left.get_device(), left.get_dtype(), [rows, columns], [columns, 1])
        return ir.TensorBox.create(cls(layout, [left, right], [None, "none", [-1], ""]))


register_lowering(torch.ops.otc_dist.product.default, type_promotion_kind=None)(_Product.create)


class LargeProducts(CustomGraphPass):
    """A pass of torch's compiler over the operations of one graph."""

    def uuid(self) -> bytes:
        """Compiled code is kept for as long as this file is the same."""
        return get_hash_for_files((__file__,))

    def __call__(self, graph: Graph) -> None:
        for operation in (aten.mm.default, aten.bmm.default):
            for node in graph.find_nodes(op="call_function", target=operation):
                left, right = node.args
                if _large(left.meta["val"], right.meta["val"]):
                    with graph.inserting_before(node):
                        node.replace_all_uses_with(_computed(graph, left, right))
                    graph.erase_node(node)


def _large(left: Tensor, right: Tensor) -> bool:
    *batch, rows, inner = left.shape
    size = rows * inner * right.shape[-1]
    return left.dtype == torch.float32 and size >= LEAST and all(copies <= MOST for copies in batch)


def _computed(graph: Graph, left: Node, right: Node) -> Node:
    """The product, of two matrices or of a batch of them, added to the graph."""
    if left.meta["val"].ndim == 2:
        return _call(graph, torch.ops.otc_dist.product.default, left, right)
    parts = []
    for index in range(len(left.meta["val"])):
        pair = [_call(graph, aten.select.int, side, 0, index) for side in (left, right)]
        part = _call(graph, torch.ops.otc_dist.product.default, *pair)
        parts.append(_call(graph, aten.unsqueeze.default, part, 0))
    return _call(graph, aten.cat.default, parts)


def _call(graph: Graph, operation: Any, *arguments: Any) -> Node:
    node = graph.call_function(operation, arguments)
    node.meta["val"] = operation(*map_arg(arguments, lambda other: other.meta["val"]))
    return node
