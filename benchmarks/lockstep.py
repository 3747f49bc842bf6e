"""How fast is a lock-step? One host and three agents, each its own process, E = 1.

    python benchmarks/lockstep.py [--starts 5] [--rounds 7] [--steps 300]

Every transport carries the same payloads: the codec's messages for 3-agent Hopper, answered by an
11-64-64-1 network in numpy. Ours also checks every field of every message and writes every step
to a real deployment log before it sends the next; the others do neither. Rounds are interleaved,
and ratios are those of the same round, so that a busy machine disturbs both alike. Each peer runs
beside ours alone (Ray's daemons cost the others time), and both are started several times: on two
cores a start's ratio depends on where its processes come to lie. gRPC and Ray
are left out where they are not installed (`pip install pyzmq grpcio ray`).
"""

import argparse
import importlib.util
import multiprocessing as mp
import os
import queue
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

import msgpack
import numpy as np

from otc_dist.bus.codec import AgentCodec
from otc_dist.bus.endpoints import Endpoint, local_endpoint, remove_local_endpoint
from otc_dist.bus.keys import Keys
from otc_dist.bus.links import QUICK_PAYLOAD
from otc_dist.bus.lockstep import HostLockstep, LearnerLockstep
from otc_dist.bus.messages import Action, Moment, Observation, StepOutcome
from otc_dist.bus.session import Session
from otc_dist.bus.wire import Rejections
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs.registry import team_spec
from otc_dist.transitions import JointStep

TEAM = team_spec("hopper-3x1")
AGENTS = range(len(TEAM.agents))
COPIES = {"deployment": 1, "evaluation": 1, "done": 0}
DIGEST = "0" * 16
CODECS = [AgentCodec("bench", agent, COPIES) for agent in TEAM.agents]
_random = np.random.default_rng(0)
SEEN = tuple(_random.standard_normal((1, 11), dtype=np.float32) for _ in AGENTS)
OUTCOME = StepOutcome(np.ones(1, np.float32), SEEN[0], np.zeros(1, np.bool_), np.zeros(1, np.bool_))
WEIGHTS = [
    _random.standard_normal(shape, dtype=np.float32) / 8 for shape in ((11, 64), (64, 64), (64, 1))
]


def policy(observations: np.ndarray) -> np.ndarray:
    first, second, last = WEIGHTS
    hidden = np.maximum(np.maximum(observations @ first, 0) @ second, 0)
    return np.tanh(hidden @ last)


def question(index: int, step: int) -> Observation:
    return Observation(Moment("deployment", 1, 1, step), SEEN[index], OUTCOME if step else None)


def plain_questions(step: int) -> list[bytes]:
    return [CODECS[index].encode_observation(question(index, step)) for index in AGENTS]


def plain_answer(payload: bytes) -> bytes:
    """What an agent of the peers does: decode, act, encode; nothing is checked."""
    version, run, agent, phase, deployment, epoch, step, body = msgpack.unpackb(payload)
    action = policy(np.frombuffer(body, "<f4", 11).reshape(1, 11))
    head = [version, run, agent, phase, deployment, epoch, step]
    return msgpack.packb([*head, action.tobytes(), DIGEST])


def plain_actions(answers: Sequence[bytes]) -> list[np.ndarray]:
    return [np.frombuffer(msgpack.unpackb(answer)[7], "<f4") for answer in answers]


Step = Callable[[int], object]
Transport = Callable[[Path], AbstractContextManager[Step]]  # leaving it ends what it started


def _serve(target: Callable[..., None], *arguments: object) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; the host ends its agents
    target(*arguments)


@contextmanager
def _agents(target: Callable[..., None], *arguments: object) -> Iterator[None]:
    context = mp.get_context("spawn")
    processes = [
        context.Process(target=_serve, args=(target, index, *arguments), daemon=True)
        for index in AGENTS
    ]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.join()


def _our_agent(index: int, endpoint: str) -> None:
    agent = TEAM.agents[index]
    with Session.connect(Endpoint(endpoint), QUICK_PAYLOAD) as session:
        side = LearnerLockstep(session, Keys("bench", "digest"), agent, COPIES, Rejections())
        while True:
            asked = side.question(60.0)
            if asked is not None and asked.observations is not None:
                side.answer(Action(asked.moment, policy(asked.observations), DIGEST))


@contextmanager
def ours(folder: Path) -> Iterator[Step]:
    endpoint = local_endpoint(folder)
    header = LogHeader("bench", 1, 0, "", "", TEAM, 1)
    writer = LogWriter.create(folder / "bench.mcap", header)
    seeds, state = np.zeros(1, np.int64), np.zeros((1, TEAM.state_size))
    with Session.listen([Endpoint(endpoint)], QUICK_PAYLOAD) as session, closing(writer):
        host = HostLockstep(
            session, Keys("bench", "digest"), TEAM.agents, COPIES, 60.0, Rejections()
        )

        def step(number: int) -> None:
            answers = host.ask([question(index, number) for index in AGENTS], acting=True)
            actions = tuple(a.actions for a in answers if a.actions is not None)
            ends = (OUTCOME.terminated, OUTCOME.truncated, (False,) * 3)
            rewards = (OUTCOME.rewards,) * 3
            writer.write(JointStep(number, SEEN, actions, rewards, SEEN, *ends, seeds, state))

        with _agents(_our_agent, endpoint):
            yield step
    remove_local_endpoint(endpoint)


def _zmq_agent(index: int, folder: str) -> None:
    import zmq

    with zmq.Context() as context, context.socket(zmq.PAIR) as socket:
        socket.connect(f"ipc://{folder}/zmq{index}")
        while True:
            socket.send(plain_answer(socket.recv()))


@contextmanager
def pyzmq(folder: Path) -> Iterator[Step]:
    import zmq

    context = zmq.Context()
    sockets = [context.socket(zmq.PAIR) for _ in AGENTS]
    for index, socket in enumerate(sockets):
        socket.bind(f"ipc://{folder}/zmq{index}")

    def step(number: int) -> list[np.ndarray]:
        for socket, payload in zip(sockets, plain_questions(number), strict=True):
            socket.send(payload)
        return plain_actions([socket.recv() for socket in sockets])

    try:
        with _agents(_zmq_agent, str(folder)):
            yield step
    finally:
        context.destroy(linger=0)


def _pipe_agent(index: int, ends: Sequence[Connection]) -> None:
    while True:
        ends[index].send_bytes(plain_answer(ends[index].recv_bytes()))


@contextmanager
def pipe(folder: Path) -> Iterator[Step]:
    pairs = [mp.get_context("spawn").Pipe() for _ in AGENTS]

    def step(number: int) -> list[np.ndarray]:
        for (mine, _), payload in zip(pairs, plain_questions(number), strict=True):
            mine.send_bytes(payload)
        return plain_actions([mine.recv_bytes() for mine, _ in pairs])

    with _agents(_pipe_agent, [theirs for _, theirs in pairs]):
        yield step


def _grpc_agent(index: int, folder: str) -> None:
    from concurrent.futures import ThreadPoolExecutor

    import grpc

    def act(requests: Iterator[bytes], _: object) -> Iterator[bytes]:
        return (plain_answer(payload) for payload in requests)

    server = grpc.server(ThreadPoolExecutor(1))
    handler = {"act": grpc.stream_stream_rpc_method_handler(act)}
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("agent", handler),))
    server.add_insecure_port(f"unix:{folder}/grpc{index}")
    server.start()
    server.wait_for_termination()


@contextmanager
def grpc_streaming(folder: Path) -> Iterator[Step]:
    import grpc

    outgoing: list[queue.SimpleQueue[bytes | None]] = [queue.SimpleQueue() for _ in AGENTS]
    channels = [grpc.insecure_channel(f"unix:{folder}/grpc{index}") for index in AGENTS]
    streams = [
        channel.stream_stream("/agent/act")(iter(source.get, None), wait_for_ready=True)
        for channel, source in zip(channels, outgoing, strict=True)
    ]

    def step(number: int) -> list[np.ndarray]:
        for source, payload in zip(outgoing, plain_questions(number), strict=True):
            source.put(payload)
        return plain_actions([next(stream) for stream in streams])

    try:
        with _agents(_grpc_agent, str(folder)):
            yield step
    finally:
        for source, channel in zip(outgoing, channels, strict=True):
            source.put(None)
            channel.close()


@contextmanager
def ray_actors(folder: Path) -> Iterator[Step]:
    import ray

    here = str(Path(__file__).resolve().parent)
    paths = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
    ray.init(
        num_cpus=len(AGENTS),
        include_dashboard=False,
        log_to_driver=False,
        logging_level="ERROR",
        runtime_env={"env_vars": {"PYTHONPATH": paths}},
    )

    class Agent:
        def act(self, payload: bytes) -> bytes:
            return plain_answer(payload)

    actors = [ray.remote(Agent).remote() for _ in AGENTS]

    def step(number: int) -> list[np.ndarray]:
        questions = zip(actors, plain_questions(number), strict=True)
        return plain_actions(ray.get([actor.act.remote(payload) for actor, payload in questions]))

    try:
        yield step
    finally:
        ray.shutdown()


# Name, what it needs, how it is made, and the most that our time a step may be of its time.
PEERS: tuple[tuple[str, str, Transport, float | None], ...] = (
    ("pyzmq", "zmq", pyzmq, 1.5),
    ("multiprocessing.Pipe", "multiprocessing", pipe, None),
    # Ray before gRPC: it starts its daemons by forking, which threads of gRPC's can hang.
    ("Ray actors", "ray", ray_actors, 1 / 5),
    ("gRPC streaming", "grpc", grpc_streaming, 1 / 2),
)


def measure(make: Transport, rounds: int, length: int) -> list[tuple[float, float]]:
    """Seconds a step of ours and of a peer's, by round, after a start of both."""
    with tempfile.TemporaryDirectory(prefix="lockstep") as name, ExitStack() as running:
        steps = [running.enter_context(start(Path(name))) for start in (ours, make)]
        found = []
        for turn in range(rounds + 1):
            times = []
            for step in steps:
                start = time.perf_counter()
                for number in range(turn * length, (turn + 1) * length):
                    step(number)
                times.append((time.perf_counter() - start) / length)
            found.append((times[0], times[1]))
    return found[1:]  # the first warms up


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--starts", type=int, default=5, help="of ours and each peer (default: 5)")
    parser.add_argument("--rounds", type=int, default=7, help="after each start (default: 7)")
    parser.add_argument("--steps", type=int, default=300, help="lock-steps a round and transport")
    arguments = parser.parse_args()
    print(f"{'':20} {'us a step':>9} {'ours':>6}   ours / its (median, range, limit)")
    for peer, module, make, limit in PEERS:
        if importlib.util.find_spec(module) is None:
            print(f"{peer:20} left out: {module} is not installed")
            continue
        pairs = []
        for turn in range(arguments.starts):
            print(f"{peer}: start {turn + 1} of {arguments.starts}", file=sys.stderr)
            pairs += measure(make, arguments.rounds, arguments.steps)
        mine, its = (1e6 * statistics.median(times) for times in zip(*pairs, strict=True))
        ratios = [a / b for a, b in pairs]
        ratio = statistics.median(ratios)
        line = f"{peer:20} {its:9,.0f} {mine:6,.0f}   {ratio:.2f}"
        line += f" ({min(ratios):.2f}..{max(ratios):.2f})"
        if limit is not None:
            line += f", at most {limit:.2f}: {'met' if ratio <= limit else 'MISSED'}"
        print(line, flush=True)


if __name__ == "__main__":
    main()
