"""A policy as one file that runs without otc_dist: ONNX for any runtime, or PyTorch's own `.pt2`.

    observations (E, s), and what is random as inputs  ->  actions (E, a)

E is free. The weights and the agent's bounds are in the file. Most policies need nothing random to
act; BCQ chooses among actions that it decodes from standard normal numbers, its input `act`.
"""

import io
import json
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec

import torch
from torch import Tensor

from otc_dist.learner.actor import Actor
from otc_dist.steps.state import State
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError

EXTRA = "onnx"  # of pyproject.toml
ABOUT = "otc_dist"  # what a file says of itself: an ONNX property, or `otc_dist.json` of a .pt2
_TRACED = 2  # observations of the example; of one torch would conclude that E is always 1


def export(actor: Actor, state: State, about: Mapping[str, object], suffix: str) -> bytes:
    """The bytes of a file of this suffix, ".onnx" or ".pt2".

    Args:
        state: what the algorithm needs to act.
        about: what the file says of itself, in JSON; which random inputs it has is added.

    Raises:
        UserError: another suffix, or ONNX without the packages that it needs.
    """
    writers = {".onnx": _onnx, ".pt2": _pt2}
    if suffix not in writers:
        raise UserError(
            f"a policy is exported to a file that ends in .onnx or .pt2, not in {suffix!r}"
        )
    specs = actor.algorithm.acting_noise_spec(_TRACED)
    noise = actor.noise("evaluation", 0, 0, _TRACED)
    described = {
        name: {"kind": kind, "shape": ["E", *shape[1:]]} for name, (kind, shape) in specs.items()
    }
    example = {"observations": torch.ones(_TRACED, actor.spec.observation_size)}
    example |= {name: torch.from_numpy(array) for name, array in noise.items()}
    metadata = json.dumps({**about, "noise": described})
    with _silent():
        return writers[suffix](_Example(_Module(actor, state, tuple(noise)), example), metadata)


class _Module(torch.nn.Module):
    """A policy as PyTorch exports it."""

    def __init__(self, actor: Actor, state: State, noise: tuple[str, ...]) -> None:
        super().__init__()
        self._algorithm, self._names, self._noise = actor.algorithm, tuple(state), noise
        for name, tensor in state.items():
            self.register_buffer(f"state_{name}", tensor.cpu())
        for name in ("centre", "scale", "low", "high"):
            self.register_buffer(name, torch.from_numpy(getattr(actor.scale, name)))

    def forward(self, observations: Tensor, *noise: Tensor) -> Tensor:
        """Actions (E, a), as `Actor.act` gives them."""
        state = {name: self.get_buffer(f"state_{name}") for name in self._names}
        by_name = dict(zip(self._noise, noise, strict=True))
        actions = self._algorithm.act(state, observations, by_name)
        exact = actions * self.get_buffer("scale") + self.get_buffer("centre")
        return exact.clamp(self.get_buffer("low"), self.get_buffer("high"))


@dataclass(frozen=True)
class _Example:
    """A policy, and an example of its inputs by name."""

    module: _Module
    inputs: dict[str, Tensor]

    def traced(self) -> torch.export.ExportedProgram:
        """The policy as operations on tensors, for any number of observations."""
        free = {0: torch.export.Dim("E")}
        noise = (free,) * (len(self.inputs) - 1)
        with torch.no_grad():
            return torch.export.export(
                self.module,
                tuple(self.inputs.values()),
                dynamic_shapes=(free, noise) if noise else (free,),
            )


def _pt2(example: _Example, about: str) -> bytes:
    buffer = io.BytesIO()
    torch.export.save(example.traced(), buffer, extra_files={f"{ABOUT}.json": about})
    return buffer.getvalue()


def _onnx(example: _Example, about: str) -> bytes:
    if not (find_spec("onnx") and find_spec("onnxscript")):
        raise UserError(f"to export ONNX needs more packages: {install(EXTRA)}")
    program = torch.onnx.export(
        example.traced(),
        input_names=list(example.inputs),
        output_names=["actions"],
        dynamo=True,
        verbose=False,
    )
    assert program is not None  # with `dynamo`
    program.model.metadata_props[ABOUT] = about
    content: bytes = program.model_proto.SerializeToString()
    return content


@contextmanager
def _silent() -> Iterator[None]:
    """Without what torch and ONNX say of packages and optimisations that no policy needs."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
