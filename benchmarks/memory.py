"""How much memory does a learner need, beside its data set?

    python benchmarks/memory.py [--only bcq,cql]

For every algorithm, a process of its own does what a learner's does: it imports torch, from where
on it counts, reads its agent's file of as many transitions as the shipped set has, makes some
updates, trains the embedding, and tunes on a deployment by OTC. The code is compiled before, in
another process, and the allocator is bounded, as the launcher does it. "now" is what the process
holds in the end, "peak" the most that it ever held, both without what bare torch takes.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from timing import ENVS, OFFLINE, ONLINE, describe, random_data, say, sections

from otc_dist.datasets import agent_files
from otc_dist.envs import registry
from otc_dist.launch.supervise.supervisor import FRUGAL
from otc_dist.spec import AgentSpec
from otc_dist.terminal.errors import run_main

TARGET = 300  # MB beside the data set
MB = 2**20


def write_file(path: Path, env_id: str, spec: AgentSpec) -> None:
    header = agent_files.Header(
        format_version=agent_files.FORMAT_VERSION,
        dataset=f"{env_id}/random",
        env_id=env_id,
        agent=spec.name,
        transitions=OFFLINE[env_id],
        observation_size=spec.observation_size,
        action_size=spec.action_size,
        origin="random numbers",
        versions={},
    )
    data = random_data(spec, OFFLINE[env_id], 0)
    path.write_bytes(agent_files.encode(header, data, np.zeros(OFFLINE[env_id], np.int64)))


def learn(name: str, path: Path) -> dict[str, float]:
    """What a learner's process does; its memory in MB."""
    import torch  # noqa: F401

    bare = held()
    from otc_dist.learner.learner import Learner

    env_id = ENVS[sections()[name].discrete]
    spec = registry.team_spec(env_id).agents[0]
    assignments = [f"algorithm.name={name}", "engine.name=compiled", "offline.updates=200"]
    if name == "bremen":
        assignments.append("algorithm.improvements=2")
    description = describe(env_id, 9, *assignments, "sampling.similarity_sample=20000")
    data = agent_files.load_agent(path, spec.name)
    size = sum(array.nbytes for array in vars(data).values()) / MB
    learner = Learner(description, spec, data, registry.task(env_id))
    del data
    learner.pretrain(lambda progress: None, lambda: None)
    learner.tune(1, random_data(spec, ONLINE, 1), lambda progress: None)
    learner.act(random_data(spec, 4, 2).observations, "deployment", 2, 0)
    return {"data": size, "now": held() - bare, "peak": peak() - bare}


def held() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / MB


def peak() -> float:
    """The most that this process held, MB; `ru_maxrss` would count what its parent held too."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / MB


def measured(name: str, folder: Path) -> dict[str, float]:
    env_id = ENVS[sections()[name].discrete]
    path = folder / f"{env_id}.safetensors"
    if not path.exists():
        write_file(path, env_id, registry.team_spec(env_id).agents[0])
    for purpose in ("compiling", "measuring"):
        say(f"{purpose} {name}")
        command = [sys.executable, __file__, "--measure", name, str(path)]
        environment = {**os.environ, **FRUGAL}
        output = subprocess.run(
            command, check=True, stdout=subprocess.PIPE, text=True, env=environment
        ).stdout
    found: dict[str, float] = json.loads(output.splitlines()[-1])
    return found


def table(names: Sequence[str]) -> str:
    lines = [f"{'memory of a learner, MB':<28}{'data':>8}{'now':>8}{'peak':>8}  target"]
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            found = measured(name, Path(folder))
            limit = found["data"] + TARGET
            verdict = "met" if found["peak"] <= limit else "MISSED"
            numbers = "".join(f"{found[key]:8.0f}" for key in ("data", "now", "peak"))
            lines.append(f"{name:<28}{numbers}  peak <= {limit:.0f}  {verdict}")
    say("")
    return "\n".join(lines)


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--only", default=",".join(sections()), help="names, with commas between")
    parser.add_argument("--measure", nargs=2, metavar=("NAME", "FILE"), help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.measure:
        name, path = arguments.measure
        print(json.dumps(learn(name, Path(path))))
    else:
        print(table(arguments.only.split(",")))
    return 0


if __name__ == "__main__":
    run_main(main)
