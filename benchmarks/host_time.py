"""How much processor time does the env host take for each agent and lock-step?

    python benchmarks/host_time.py [--agents 24] [--rounds 60] [--other CLONE]

A real env host, Cooperative Navigation, E = 1, and for each agent a process that answers at once,
over Zenoh: where all meet at the env host; where all meet at a Zenoh router (`bus.router`), whose
own time is not counted; and, with --other, by the code of another clone of this repository, which
has a `.venv` of its own. They take turns of some lock-steps, and a ratio is that of the same round,
so that a busy machine disturbs all alike; the lowest tenth is what it takes while little disturbs.
At the end, what each part of our own code takes when it is called alone, with warm caches.
"""

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from otc_dist.bus.codec import AgentCodec
from otc_dist.bus.endpoints import local_endpoint
from otc_dist.bus.lockstep import HostLockstep, LearnerLockstep
from otc_dist.bus.messages import Action, Moment, Observation, StepOutcome
from otc_dist.bus.session import Session
from otc_dist.bus.wire import Rejections
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout
from otc_dist.services import env_host
from otc_dist.services.process import Run
from otc_dist.spec import AgentSpec

ROUTER = Path(__file__).parents[1] / "tests" / "services" / "router.py"
DIGEST = "0" * 16
PARTS = ("questions", "encode", "checks", "environment", "log")


def answer(run: Run, agent: AgentSpec, locator: str) -> None:
    """Be one agent, until this process is ended."""
    # An earlier commit's runs and endpoints have another name for it.
    kind = type(getattr(run, "local_bus", None) or run.local_door)
    with Session.connect(kind(locator), run.maximum_payload, 120.0) as session:
        side = LearnerLockstep(session, run.keys, agent, run.copies, Rejections())
        session.declare_alive(run.keys.alive(agent.name))
        actions = np.zeros((1, agent.action_size), np.float32)
        while True:
            asked = side.question(60.0)
            if asked is not None:
                side.answer(Action(asked.moment, actions, DIGEST))


def play(agents: int, steps: int, total: int, root: Path, router: str) -> None:
    """The env host: so many lock-steps for each line of the standard input; answers with seconds of
    the clock, of processor time, and of that Zenoh's thread's.
    """
    name = f"cooperative-navigation-{agents}"
    data = {"name": "time", "env": {"id": name}, "dataset": {"name": f"{name}/random"}}
    settings = ("env.copies=1", "deployment.count=1", "evaluation.episodes=0", "offline.updates=1")
    more = (f"deployment.transitions={total}", "dataset.transitions=100")
    description = Description.build(data, [*settings, *more, "bus.answer_deadline=300.0"])
    (root / "description.toml").write_text(description.to_toml())
    (root / "run.json").write_text(json.dumps({"run": "benchmark"}))
    run = Run.open(root)
    for agent in run.team.agents:
        if os.fork() == 0:
            answer(run, agent, router or local_endpoint(run.folder.root))
    ask, begun, asked = HostLockstep.ask, (0.0, 0.0, 0.0), 0

    def paced(self: HostLockstep, questions: list[Observation], *, acting: bool) -> list[Action]:
        nonlocal begun, asked
        if asked % steps == 0:
            if asked:
                print(*(a - b for a, b in zip(clocks(), begun, strict=True)), flush=True)
            sys.stdin.readline()
            begun = clocks()
        asked += 1
        return ask(self, questions, acting=acting)

    HostLockstep.ask = paced  # type: ignore[method-assign]
    sys.argv = [
        "env_host",
        "--run",
        str(root),
        *(["--connect", router, "--insecure"] * bool(router)),
    ]
    env_host.main()


def clocks() -> tuple[float, float, float]:
    """Now: the clock, this process's processor time, and that of Zenoh's threads in it, seconds."""
    threads = Path("/proc/self/task").iterdir()
    zenoh = [thread for thread in threads if (thread / "comm").read_text().startswith("rx")]
    used = sum(int((thread / "schedstat").read_text().split()[0]) for thread in zenoh) / 1e9
    return time.perf_counter(), time.process_time(), used


class Side:
    """An env host with its agents, and a router if it is to have one."""

    def __init__(self, python: Path, arguments: list[str], root: Path, routed: bool) -> None:
        root.mkdir()
        router, self._steps, self._agents = "", int(arguments[1]), int(arguments[0])
        self._processes: list[subprocess.Popen[str]] = []
        if routed:
            with socket.create_server(("127.0.0.1", 0)) as free:
                router = f"tcp/127.0.0.1:{free.getsockname()[1]}"
            self._start([sys.executable, str(ROUTER), router])
        self._start([str(python), __file__, "--play", *arguments, str(root), router])

    def _start(self, command: list[str]) -> None:
        pipe = subprocess.PIPE  # a group of its own, which is ended with all its processes
        self._processes.append(
            subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, process_group=0)
        )

    def turn(self) -> list[float]:
        """Some lock-steps: milliseconds each, microseconds of processor time an agent, and of that
        Zenoh's thread's."""
        host = self._processes[-1]
        assert host.stdin and host.stdout
        host.stdin.write("\n")
        host.stdin.flush()
        clock, used, zenoh = (float(part) / self._steps for part in host.stdout.readline().split())
        return [1e3 * clock, 1e6 * used / self._agents, 1e6 * zenoh / self._agents]

    def close(self) -> None:
        for process in self._processes:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def alone(agents: int, folder: Path, steps: int = 600) -> NDArray[np.float64]:
    """Microseconds an agent by `PARTS`, each called for all agents in turn; lowest tenths."""
    env = registry.make(f"cooperative-navigation-{agents}", 1)
    codecs = [AgentCodec("benchmark", agent, {"deployment": 1}) for agent in env.spec.agents]
    log = LogWriter.create(folder / "log.mcap", LogHeader("benchmark", 1, 0, "", "", env.spec, 1))
    rollout, last, tags = Rollout(env, 0, "deployment", 1), None, (False,) * agents
    actions = [np.zeros((1, agent.action_size), np.float32) for agent in env.spec.agents]
    found = np.zeros((steps, len(PARTS)))
    for number in range(steps):
        moment = Moment("deployment", 1, 1, number)
        sent = [
            c.encode_action(Action(moment, a, DIGEST)) for c, a in zip(codecs, actions, strict=True)
        ]
        marks = [time.perf_counter()]
        questions = [
            Observation(moment, seen, StepOutcome.of(last, index) if last else None)
            for index, seen in enumerate(rollout.observations)
        ]
        marks.append(time.perf_counter())
        for codec, question in zip(codecs, questions, strict=True):
            codec.encode_observation(question)
        marks.append(time.perf_counter())
        pairs = zip(codecs, sent, strict=True)
        answers = [codec.decode_action(payload, moment, acting=True) for codec, payload in pairs]
        marks.append(time.perf_counter())
        last = rollout.advance([a.actions for a in answers if a.actions is not None], tags)
        marks.append(time.perf_counter())
        log.write(last)
        found[number] = np.diff([*marks, time.perf_counter()])
    log.close()
    return np.quantile(found, 0.1, axis=0) * 1e6 / agents


def main(argv: list[str]) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--agents", type=int, default=24, help="default: %(default)s")
    parser.add_argument("--steps", type=int, default=20, help="lock-steps a turn (%(default)s)")
    parser.add_argument("--rounds", type=int, default=60, help="turns of each (%(default)s)")
    parser.add_argument("--other", type=Path, metavar="CLONE", help="compare with its env host")
    options = parser.parse_args(argv)
    kinds = {"here": (Path(sys.executable), False), "router": (Path(sys.executable), True)}
    if options.other:
        kinds["other"] = (options.other.resolve() / ".venv" / "bin" / "python", False)
    total = options.steps * (options.rounds + 3)
    arguments = [str(number) for number in (options.agents, options.steps, total)]
    sides: list[Side] = []
    with tempfile.TemporaryDirectory(prefix="host-time-") as name:
        try:
            for kind, (python, routed) in kinds.items():
                sides.append(Side(python, arguments, Path(name) / kind, routed))
                sides[-1].turn()
            turns = [list(range(len(sides)))[:: (-1) ** number] for number in range(options.rounds)]
            found = np.zeros((options.rounds, len(sides), 3))
            for number, order in enumerate(turns):
                for index in order:
                    found[number, index] = sides[index].turn()
        finally:
            for side in sides:
                side.close()
        parts = alone(options.agents, Path(name))
    print(f"{options.agents} agents, us of processor time an agent and step: lowest tenth, median")
    for index, kind in enumerate(kinds):
        clock, used, zenoh = found[:, index].T
        low, middle, high = np.quantile(used / found[:, 0, 1], (0.25, 0.5, 0.75))
        print(
            f"{kind:7} {np.quantile(used, 0.1):6.1f} {np.median(used):6.1f}, of that Zenoh's thread"
            f" {np.median(zenoh / used):.0%}; by here's {middle:.2f} ({low:.2f}..{high:.2f});"
            f" a lock-step {np.quantile(clock, 0.1):.2f} ms, by here's"
            f" {np.median(clock / found[:, 0, 0]):.2f}",
            flush=True,
        )
    listed = ", ".join(f"{part} {value:.1f}" for part, value in zip(PARTS, parts, strict=True))
    print(f"our own code, called alone: {listed}; together {sum(parts):.1f}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--play"]:
        _, _, agents, steps, total, root, router = sys.argv
        play(int(agents), int(steps), int(total), Path(root), router)
    else:
        main(sys.argv[1:])
