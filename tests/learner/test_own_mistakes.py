"""A mistake in an algorithm or a sampling strategy of the user's own is one line that says what."""

import re
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
import pytest
import torch
from torch import Tensor

from otc_dist.algorithms.interface import Batch
from otc_dist.description import user_code
from otc_dist.learner.learner import Learner
from otc_dist.otc.distances.interface import Scores
from otc_dist.otc.samplers.interface import Extent, Indices, MergedData, Sampler
from otc_dist.steps.noise import Noise
from otc_dist.steps.state import State
from otc_dist.terminal.errors import UserError

from ..brains import SPEC, describe, online, silent, transitions, unsaved
from ..toys import Cloning, CloningSection, Late, Recent, RecentSection


class Still(Cloning):
    act = property()  # type: ignore[assignment]


class Judging(Cloning):
    Section = type("Section", (CloningSection,), {"has_q": True, "__module__": __name__})


class Talkative(Cloning):
    def update(
        self, state: State, batch: Batch, imitated: Batch, noise: Noise
    ) -> tuple[State, Tensor]:
        return super().update(state, batch, imitated, noise)[0], torch.zeros(3)


class Flat(Cloning):
    def act(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        return super().act(state, observations, noise)[:, 0]


class Beyond(Recent):
    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        return {"batch": np.full((updates, self.batch_size), extent.size)}


@dataclass(frozen=True)
class Blank(Sampler):
    Section = RecentSection

    settings: RecentSection
    batch_size: int


class Nowhere(Late):
    scores = property()  # type: ignore[assignment]


class Everywhere(Late):
    def scores(self, held: MergedData, *, exclude_self: bool) -> Scores:
        return Scores(torch.zeros(len(held.data.rows)))


MISTAKES = [
    ("algorithm.name", Still, "Still has no act: otc_dist.algorithms.interface.Algorithm says"),
    ("algorithm.name", Judging, "Judging has no q, value_noise_spec, value: otc_dist.algorithms."),
    ("algorithm.name", Talkative, "an update has to give 1 metrics (loss), not the shape (3,)"),
    ("algorithm.name", Flat, "act has to give actions of shape (3, 2), not (3,)"),
    ("sampling.name", Beyond, "tuning training diverged before update 6: loss is nan"),
    ("sampling.name", Blank, "Can't instantiate abstract class Blank"),
    ("sampling.distance", Nowhere, "Nowhere has no scores: otc_dist.otc.distances.interface."),
    ("sampling.distance", Everywhere, "scores has to give 240 numbers, not the shape (280,)"),
]


@pytest.mark.parametrize(
    ("setting", "part", "said"), MISTAKES, ids=lambda one: getattr(one, "__name__", "")
)
def test_a_mistake_is_one_line_that_says_what_was_expected(
    setting: str, part: type, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(user_code, "_allowed", set())
    cloning = "algorithm={name='tests.toys:Cloning'}"  # whose loss shows what it was given
    name = f"{__name__}:{part.__name__}"
    described = describe(cloning, f"{setting}={name}").trusted()
    with pytest.raises(UserError) as told, user_code.answers_for(name):
        learner = Learner(described, SPEC, transitions(0, 200))
        learner.pretrain(silent, unsaved)
        learner.act(transitions(1, 3).observations, "deployment", 1, 0)
        learner.tune(1, online(1), silent)
    line = str(told.value)
    assert said in line and "\n" not in line
    place = re.search(r"\((\S+):\d+\)$", line)
    assert not place or place[1] == __file__  # never one of ours


def test_a_service_is_no_place_of_the_users() -> None:
    """It lies beside the package in a checkout, and is run as `__main__`."""
    names = {"__name__": "__main__", "__spec__": find_spec("otc_dist.services.learner")}
    exec(compile("def serve(part): part()", "services/learner.py", "exec"), names)
    with pytest.raises(TypeError) as raised:
        names["serve"](None)  # type: ignore[operator]
    assert user_code.described(raised.value).endswith(f"({__file__}:{raised.tb.tb_lineno})")
