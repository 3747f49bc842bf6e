"""What a compiled function computes twice is computed once.

An algorithm says what its losses are, each whole: two of them may ask one network about the same
rows. torch's compiler removes such repetitions where it differentiates a function itself, not from
the functions that a step consists of. What is computed is the same, to the bit.
"""

import operator

from torch._inductor.custom_graph_pass import CustomGraphPass, get_hash_for_files
from torch._ops import OpOverload
from torch.fx import Graph, Node


class RepeatedTerms(CustomGraphPass):
    """A pass of torch's compiler over one graph: equal operations on equal values become one."""

    def uuid(self) -> bytes:
        """Compiled code is kept for as long as this file is the same."""
        return get_hash_for_files((__file__,))

    def __call__(self, graph: Graph) -> None:
        first: dict[tuple[object, str, str], Node] = {}
        returned = graph.output_node().all_input_nodes  # each is to be a tensor of its own
        for node in graph.nodes:
            if node in returned or not _is_pure(node):
                continue
            known = first.setdefault((node.target, repr(node.args), repr(node.kwargs)), node)
            if known is not node:
                node.replace_all_uses_with(known)
                graph.erase_node(node)


def _is_pure(node: Node) -> bool:
    """Whether a node's value depends on its arguments alone, and it does nothing else."""
    if node.target is operator.getitem:
        return True
    return isinstance(node.target, OpOverload) and not node.is_impure()
