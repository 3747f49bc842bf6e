"""What benchmarks/lockstep.py times: a lock-step over our bus, and over the transports of others.

All carry the codec's messages for 3-agent Hopper, answered by an 11-64-64-1 network in NumPy, each
agent in a process of its own.
"""

import multiprocessing as mp
import os
import queue
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
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
from otc_dist.run.folder import RunFolder
from otc_dist.transitions import JointStep

TEAM = team_spec("hopper-3x1")
AGENTS = range(len(TEAM.agents))
COPIES = {"deployment": 1, "evaluation": 1, "done": 0}
DIGEST = "0" * 16
KEYS = Keys("bench", "digest")
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
        side = LearnerLockstep(session, KEYS, agent, COPIES, Rejections())
        while True:
            asked = side.question(60.0)
            if asked is not None and asked.observations is not None:
                side.answer(Action(asked.moment, policy(asked.observations), DIGEST))


@contextmanager
def ours(folder: Path) -> Iterator[Step]:
    endpoint = local_endpoint(folder)
    header = LogHeader("bench", 1, 0, "", "", TEAM, 1)
    writer = LogWriter.create(RunFolder(folder).deployment(1), header)
    seeds, state = np.zeros(1, np.int64), np.zeros((1, TEAM.state_size))
    with Session.listen([Endpoint(endpoint)], QUICK_PAYLOAD) as session, closing(writer):
        host = HostLockstep(session, KEYS, TEAM.agents, COPIES, 60.0, Rejections())

        def step(number: int) -> None:
            answers = host.ask([question(index, number) for index in AGENTS], acting=True)
            actions = tuple(a.actions for a in answers if a.actions is not None)
            ends = (OUTCOME.terminated, OUTCOME.truncated)
            rewards, rest = (OUTCOME.rewards,) * 3, ((False,) * 3, seeds, state)
            writer.write(JointStep(SEEN, actions, rewards, SEEN, *ends, number, *rest))

        with _agents(_our_agent, endpoint):
            yield step
    remove_local_endpoint(endpoint)


def _zenoh_agent(index: int, endpoint: str) -> None:
    name = TEAM.agents[index].name
    with Session.connect(Endpoint(endpoint), QUICK_PAYLOAD) as session:
        inbox, put = session.inbox(KEYS.observation(name)), session.publisher(KEYS.action(name))
        session.declare_alive(KEYS.alive(name))
        while True:
            payload = inbox.get(time.monotonic() + 60.0)
            if payload is not None:
                put(plain_answer(payload))


@contextmanager
def zenoh_alone(folder: Path) -> Iterator[Step]:
    """Our sessions with what the peers do, and nothing else: what Zenoh costs in Python."""
    endpoint = local_endpoint(folder / "alone")
    with Session.listen([Endpoint(endpoint)], QUICK_PAYLOAD) as session:
        names = [agent.name for agent in TEAM.agents]
        puts = [session.publisher(KEYS.observation(name)) for name in names]
        inboxes = [session.inbox(KEYS.action(name)) for name in names]

        def step(number: int) -> list[np.ndarray]:
            for put, payload in zip(puts, plain_questions(number), strict=True):
                put(payload)
            until = time.monotonic() + 60.0
            return plain_actions([inbox.get(until) or b"" for inbox in inboxes])

        with _agents(_zenoh_agent, endpoint):
            for name in names:
                while not session.is_alive(KEYS.alive(name), 1.0):
                    pass
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
