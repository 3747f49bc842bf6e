"""A run in which an environment hangs in `step` and a learner in `act`, once each."""

import json
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from otc_dist.launch.plan.run_record import RunRecord
from otc_dist.run.folder import RunFolder

from .conftest import Launcher

pytestmark = pytest.mark.slow

ENVIRONMENT = """
    import pathlib, signal, sys
    import numpy as np
    from gymnasium.spaces import Box
    from pettingzoo import ParallelEnv

    HOST = "otc_dist.services.env_host" in sys.orig_argv  # others step it too, to make the data

    class Hanging(ParallelEnv):
        metadata = {"name": "hanging"}
        max_cycles = 10
        possible_agents = ["a_0", "a_1"]

        def observation_space(self, agent): return Box(-1, 1, (2,), np.float32)
        def action_space(self, agent): return Box(-1, 1, (1,), np.float32)

        def reset(self, seed=None, options=None):
            self.t, self.x = 0, np.random.default_rng(seed).uniform(-1, 1, 2).astype(np.float32)
            self.agents = list(self.possible_agents)
            return dict.fromkeys(self.agents, self.x), {agent: {} for agent in self.agents}

        def step(self, actions):
            mark = pathlib.Path("hang_in_step")
            if HOST and self.t == 3 and mark.exists():
                mark.unlink()
                signal.pause()
            self.t += 1
            names, over = self.possible_agents, self.t == self.max_cycles
            self.agents = [] if over else list(names)
            reward = -float(np.abs(self.x).sum()) - sum(float(a[0]) for a in actions.values())
            ends = (dict.fromkeys(names, False), dict.fromkeys(names, over))
            infos = {name: {} for name in names}
            return dict.fromkeys(names, self.x), dict.fromkeys(names, reward), *ends, infos

    def make(): return Hanging()
"""
# In every process that Python starts here; it acts in one.
SITE = """
    import pathlib, sys
    if "a_1" in sys.orig_argv and "otc_dist.services.learner" in sys.orig_argv:
        import threading, time
        mark = pathlib.Path("hang_in_act")
        def wait_for_the_brain():
            while not hasattr(sys.modules.get("otc_dist.learner.learner"), "Learner"):
                time.sleep(0.001)
            learner = sys.modules["otc_dist.learner.learner"].Learner
            act = learner.act
            def hanging(self, seen, phase, deployment, step, **how):
                if phase == "deployment" and step == 5 and mark.exists():
                    mark.unlink()
                    threading.Event().wait()
                return act(self, seen, phase, deployment, step, **how)
            learner.act = hanging
        threading.Thread(target=wait_for_the_brain, daemon=True).start()
"""


def test_who_hangs_is_started_again_and_nobody_else(
    launch: Callable[..., Launcher],
    tmp_path: Path,
    tiny_flags: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, code in (("hanging", ENVIRONMENT), ("sitecustomize", SITE)):
        (tmp_path / f"{name}.py").write_text(textwrap.dedent(code))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    deadline = 8.0  # of which three quarters are waited, twice
    flags = ("env.id=hanging:make", "env.copies=2", "sampling.name=uniform", "algorithm.name=td3bc")
    flags += ("dataset.name=random", "dataset.transitions=300", "deployment.count=1")
    flags += (f"bus.answer_deadline={deadline}",)
    assigned = [part for flag in flags for part in ("--set", flag)]
    for mark in ("hang_in_step", "hang_in_act"):
        (tmp_path / mark).touch()
    launcher = launch("navigation", *tiny_flags, *assigned, "--out", "run")
    assert launcher.finish() == 0, launcher.text
    assert RunRecord.read(RunFolder(tmp_path / "run")).state == "finished"
    assert not list(tmp_path.glob("hang_in_*")), "nobody has hung"
    patience = f"{0.75 * deadline:g} s"
    assert [line for line in launcher.lines if line.endswith("; killed")] == [
        f"host: has made no progress for {patience}; killed",
        f"a_1: has given the env host no answer for {patience}; killed",
    ]
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert results["complete"]
