"""Plain torch modules with the library's weights: flat vectors, and their parts as views."""

from collections.abc import Iterator, Mapping, Sequence

import torch
from torch import Tensor, nn

# Networks whose layers lie side by side, as twins' do; one network; or one parameter.
Part = Sequence[nn.Module] | nn.Module | nn.Parameter
Parts = Mapping[str, Sequence[Part]]  # by the state's keys, one after another in its vector


def load(parts: Parts, state: Mapping[str, Tensor]) -> None:
    """The state's weights become the modules'."""
    for name, held in parts.items():
        set_flat(held, state[name])


def set_flat(parts: Sequence[Part], flat: Tensor) -> None:
    views = list(_views(parts))
    shares = flat.reshape(-1).split([view.numel() for view in views])
    for view, share in zip(views, shares, strict=True):
        view.copy_(share.view(view.shape))


def get_flat(parts: Sequence[Part]) -> Tensor:
    return torch.cat([view.reshape(-1) for view in _views(parts)])


def _views(parts: Sequence[Part]) -> Iterator[Tensor]:
    """Layer by layer weights (in, out) of all networks of a part, then their biases."""
    for part in parts:
        if isinstance(part, nn.Parameter):
            yield part.data
            continue
        networks = [part] if isinstance(part, nn.Module) else part
        for layers in zip(*map(_linears, networks), strict=True):
            yield from (layer.weight.data.T for layer in layers)
            yield from (layer.bias.data for layer in layers)


def _linears(network: nn.Module) -> list[nn.Linear]:
    return [module for module in network.modules() if isinstance(module, nn.Linear)]
