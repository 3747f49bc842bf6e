"""Matrix products in the form that is fastest, in code that torch compiles for the CPU.

torch computes float32 products by MKL, which leaves half of some AMD processors' vector width
unused: large ones go to oneDNN, which torch brings for convolutions, and which uses all of it. And
MKL is slow where a product has a few columns: thin ones are computed transposed. Results differ by
rounding.
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
THIN = range(2, 13)  # columns of a product that MKL computes in half of the time transposed
TALL = 64  # rows, and inner dimension, from which that is so
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


class Products(CustomGraphPass):
    """A pass of torch's compiler over the operations of one graph."""

    def uuid(self) -> bytes:
        """Compiled code is kept for as long as this file is the same."""
        return get_hash_for_files((__file__,))

    def __call__(self, graph: Graph) -> None:
        for operation in (aten.mm.default, aten.bmm.default):
            for node in graph.find_nodes(op="call_function", target=operation):
                left, right = node.args
                if left.meta["val"].dtype != torch.float32:
                    continue
                *_, rows, inner = left.meta["val"].shape
                columns = right.meta["val"].shape[-1]
                with graph.inserting_before(node):
                    if _large(left.meta["val"], right.meta["val"]):
                        replacement = _computed(graph, left, right)
                    elif columns in THIN and min(rows, inner) >= TALL:
                        replacement = _transposed(graph, operation, left, right)
                    else:
                        continue
                node.replace_all_uses_with(replacement)
                graph.erase_node(node)


def _large(left: Tensor, right: Tensor) -> bool:
    *batch, rows, inner = left.shape
    size = rows * inner * right.shape[-1]
    return size >= LEAST and all(copies <= MOST for copies in batch)


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


def _transposed(graph: Graph, operation: Any, left: Node, right: Node) -> Node:
    """The same product as (right^T left^T)^T."""
    order = [1, 0] if operation is aten.mm.default else [0, 2, 1]
    flipped = [_call(graph, aten.permute.default, side, order) for side in (right, left)]
    found = _call(graph, operation, *flipped)
    return _call(graph, aten.permute.default, found, order)


def _call(graph: Graph, operation: Any, *arguments: Any) -> Node:
    node = graph.call_function(operation, arguments)
    node.meta["val"] = operation(*map_arg(arguments, lambda other: other.meta["val"]))
    return node
