"""How does a run grow with its agents?

    python benchmarks/scale.py [--agents 2,4,8,16,32] [--steps 400]

For each number N of agents one whole short run by the launcher: N learner processes and the env
host on this machine, Cooperative Navigation, E = 1, networks and updates as few as can be. Of its
deployment it prints, a lock-step:

    ms          between two steps in the log, median
    host CPU    milliseconds of processor time of the env host, all its threads
    per agent   the same divided by N
    bytes       of the messages both ways (Zenoh adds about 30 to each; statuses are two a second)
    learner CPU milliseconds of processor time of one learner, mean
    MB          resident memory of the env host

Fits host CPU = a + b N to these, and says what that means for 1,000 agents on 100 hosts under the
assumptions that docs/scale.md explains. Exit status 1 if a run fails, or if the host's processor
time grows faster than N.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from otc_dist.bus.codec import AgentCodec
from otc_dist.bus.messages import Action, Moment, Observation, StepOutcome
from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.reader import OpenLog
from otc_dist.envs.registry import team_spec
from otc_dist.launch.supervise.supervisor import die_with_parent
from otc_dist.run.folder import RunFolder
from otc_dist.spec import AgentSpec
from otc_dist.terminal.errors import UserError, run_main

LOOK = 0.05  # seconds
WARM_UP = 20  # lock-steps
PATIENCE = 900.0  # seconds for one run
SLACK = 1.1  # of the growth, for what a shared machine disturbs

# A cluster: what the model assumes.
AGENTS, ROUND_TRIP_MS, GIGABITS, ACT_MS = 1000, 0.2, 10.0, 2.0


@dataclass(frozen=True)
class Measured:
    agents: int
    milliseconds: float  # a lock-step
    host_cpu: float  # ms a lock-step
    learner_cpu: float
    bytes: int
    megabytes: float


def run(agents: int, steps: int, folder: RunFolder) -> Measured:
    """One run, measured while its deployment goes on."""
    settings = (
        f"env.agents={agents}", "env.copies=1", "algorithm.name=td3bc", "algorithm.hidden=[16]",
        "algorithm.batch_size=16", "sampling.name=uniform", "dataset.transitions=100",
        "offline.updates=1", "deployment.count=1", f"deployment.transitions={steps}",
        "deployment.updates=1", "evaluation.episodes=0", "engine.name=eager",
        "bus.answer_deadline=600.0",
    )  # fmt: skip
    flags = [part for setting in settings for part in ("--set", setting)]
    command = [sys.executable, "-m", "otc_dist.launch", "cooperative_navigation", *flags]
    samples: list[Sample] = []
    with tempfile.TemporaryFile() as output:
        launcher = subprocess.Popen(
            [*command, "--out", str(folder.root)],
            stdout=output,
            stderr=output,
            preexec_fn=die_with_parent(),
        )
        try:
            deadline = time.monotonic() + PATIENCE
            while launcher.poll() is None:
                sample = look(folder)
                if sample is not None:
                    samples.append(sample)
                if time.monotonic() > deadline:
                    raise TimeoutError(f"{agents} agents: no end after {PATIENCE:.0f} s")
                time.sleep(LOOK)
        finally:
            launcher.terminate()
            if launcher.wait() != 0:
                output.seek(0)
                sys.stderr.write(output.read().decode(errors="replace")[-2000:])
    if launcher.returncode != 0 or len(samples) < 2:
        raise UserError(f"the run with {agents} agents failed")
    first, last = samples[0], samples[-1]
    count = last.step - first.step
    used = {name: 1000 * (last.cpu[name] - first.cpu[name]) / count for name in first.cpu}
    return Measured(
        agents,
        1000 * (last.clock - first.clock) / count,
        used.pop("host"),
        statistics.mean(used.values()),
        step_bytes(team_spec(f"cooperative-navigation-{agents}").agents[0]) * agents,
        last.megabytes,
    )


@dataclass(frozen=True)
class Sample:
    clock: float
    step: int
    cpu: dict[str, float]  # seconds, by process
    megabytes: float  # of the host


def look(folder: RunFolder) -> Sample | None:
    """How far the deployment is; None before it goes and after it."""
    try:
        with OpenLog(partial_path(folder.deployment(1))) as log:
            step = (log.size - log.first) // log.layout.size
        if step < WARM_UP:
            return None
        processes = json.loads(folder.supervision.read_text())["processes"]
        cpu = {name: _cpu(process["pid"]) for name, process in processes.items()}
        return Sample(time.monotonic(), step, cpu, _resident(processes["host"]["pid"]))
    except (OSError, ValueError, UserError):
        return None


def _cpu(pid: int) -> float:
    """Seconds of processor time of all threads of a process."""
    threads = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(thread.read_text().split()[0]) for thread in threads) / 1e9


def _resident(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1e6


def step_bytes(agent: AgentSpec) -> int:
    """Bytes of one agent's question and answer, E = 1."""
    codec = AgentCodec("run-of-usual-name-abcdef", agent, {"deployment": 1})
    seen, end = np.zeros((1, agent.observation_size), np.float32), np.zeros(1, np.bool_)
    moment = Moment("deployment", 1, 1, 1)
    outcome = StepOutcome(np.zeros(1, np.float32), seen, end, end)
    action = Action(moment, np.zeros((1, agent.action_size), np.float32), "0" * 16)
    question = codec.encode_observation(Observation(moment, seen, outcome))
    return len(question) + len(codec.encode_action(action))


def explain(measured: list[Measured]) -> bool:
    """Fit the host's time, say what it means for a cluster; whether it grows no faster than N."""
    agents = np.array([m.agents for m in measured], float)
    slope, base = np.polyfit(agents, [m.host_cpu for m in measured], 1)
    print(f"\nhost CPU a lock-step = {base:.2f} ms + {slope:.3f} ms x N")
    least, most = measured[0], measured[-1]
    growth = most.host_cpu / least.host_cpu
    factor = most.agents / least.agents
    fine = growth <= SLACK * factor
    print(
        f"from {least.agents} to {most.agents} agents it grows {growth:.1f} times, N {factor:.0f}"
        f" times: {'no faster than N' if fine else 'FASTER than N'}"
    )
    host = base + slope * AGENTS
    cluster = f"{ROUND_TRIP_MS} ms round trip, {GIGABITS:g} Gbit/s, acting {ACT_MS} ms"
    print(f"\n{AGENTS:,} agents, {cluster}")
    columns = ("MB/step", "wire ms", "host ms", "step ms")
    print(f"{'numbers each agent sees':>26}" + "".join(f"{name:>9}" for name in columns))
    for size in (11, 100, 4 * AGENTS):
        megabytes = AGENTS * step_bytes(AgentSpec("agent_000", size, (-1.0,), (1.0,))) / 1e6
        wire = 8 * megabytes / GIGABITS
        step = max(host, wire) + ROUND_TRIP_MS + ACT_MS
        print(f"{size:26,} {megabytes:8.2f} {wire:8.1f} {host:8.1f} {step:8.1f}")
    return fine


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--agents", default="2,4,8,16,32", help="default: %(default)s")
    parser.add_argument("--steps", type=int, default=400, help="lock-steps a run")
    arguments = parser.parse_args(argv)
    columns = ("agents", "ms", "host CPU", "per agent", "bytes", "learner CPU", "MB")
    print("".join(f"{name:>12}" for name in columns))
    measured = []
    with tempfile.TemporaryDirectory(prefix="scale-") as name:
        for agents in map(int, arguments.agents.split(",")):
            m = run(agents, arguments.steps, RunFolder(Path(name) / str(agents)))
            measured.append(m)
            print(
                f"{m.agents:12} {m.milliseconds:11.2f} {m.host_cpu:11.2f}"
                f" {m.host_cpu / m.agents:11.3f} {m.bytes:11,} {m.learner_cpu:11.2f}"
                f" {m.megabytes:11.0f}",
                flush=True,
            )
    return int(not explain(measured)) if len(measured) > 1 else 0


if __name__ == "__main__":
    run_main(main)
