"""Runs a service with faults put in and with a record of what it touched.

    python wrapped.py RECORD.json FAULTS.json env_host --run DIR ...

Faults, all optional:
    stub        the learner's brain is the small one below, without torch; "elsewhere": as another
                kind of processor trains it
    drop        every message is lost the first so many times
    delay       every message waits up to so many seconds, from a generator seeded by the process
    late        [n, seconds]: every n-th message waits so long
    patient     the env host breaks off no episode, however many deadlines a busy machine misses
    kill        [phase, deployment, step]: SIGKILL itself instead of publishing its message of then
    hold        [phase, deployment, step, FIFO]: wait there before the first message of then
    mute        publish no actions
    version     speak this protocol version
    full_disk   writing a log fails after so many steps
RECORD gets the files that were opened and the keys that were declared.
"""

import atexit
import errno
import hashlib
import json
import os
import random
import runpy
import signal
import sys
import time
import types
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import msgpack


def _stub(where: str) -> types.ModuleType:
    """A brain that acts and learns in microseconds, by all that it has seen, to the bit."""
    import numpy as np

    from otc_dist.terminal.errors import UserError

    module = types.ModuleType("otc_dist.learner.learner")

    @dataclass(frozen=True)
    class Progress:
        phase: str
        deployment: int
        update: int
        updates: int
        metrics: dict[str, float]

    def digest(*parts: bytes) -> bytes:
        return hashlib.blake2b(b"".join(parts), digest_size=32).digest()

    class Learner:
        def __init__(self, description, spec, data, task, place) -> None:  # type: ignore[no-untyped-def]
            self.tuned, self._spec, self._expected = -1, spec, 0
            self._state = digest(spec.name.encode(), data.observations.tobytes(), where.encode())

        def _seen(self, data) -> bytes:  # type: ignore[no-untyped-def]
            return digest(*(getattr(data, f).tobytes() for f in data.__dataclass_fields__))

        def pretrain(self, report, save) -> None:  # type: ignore[no-untyped-def]
            save()
            report(Progress("offline", 0, 1, 1, {"loss": 1.0}))
            self.tuned = 0

        def act(self, observations, phase, deployment, step, *, exploring):  # type: ignore[no-untyped-def]
            size = self._spec.action_size
            key = np.frombuffer(self._state, "<u8")[:2]
            weights = np.random.Generator(np.random.Philox(key=key)).standard_normal(
                (observations.shape[1], size)
            )
            return np.tanh(observations @ weights.astype(np.float32)).astype(np.float32)

        def tune(self, deployment, data, report) -> None:  # type: ignore[no-untyped-def]
            assert deployment == self.tuned + 1 == self._expected + 1
            report(Progress("tuning", deployment, 0, 1, {"alpha": 1.0, "similarity": 0.5}))
            self._state = digest(self._state, self._seen(data))
            self.tuned, self._expected = deployment, deployment

        def revert(self, path) -> None:  # type: ignore[no-untyped-def]
            tuned = self.tuned
            self.load(path)
            self.tuned = tuned

        def restore(self, online) -> None:  # type: ignore[no-untyped-def]
            self._expected += len(online)

        def policy_digest(self) -> str:
            return self._state.hex()[:16]

        def save(self, path) -> None:  # type: ignore[no-untyped-def]
            new = path.with_suffix(".new")
            new.write_text(json.dumps([self.tuned, self._state.hex()]))
            new.replace(path)

        def check(self, path) -> tuple[int, str]:  # type: ignore[no-untyped-def]
            try:
                tuned, state = json.loads(path.read_text())
            except (OSError, ValueError):
                raise UserError(f"{path} is corrupt") from None
            return tuned, state

        def load(self, path) -> None:  # type: ignore[no-untyped-def]
            self.tuned, state = self.check(path)
            self._state = bytes.fromhex(state)

    module.Learner, module.Progress = Learner, Progress  # type: ignore[attr-defined]
    return module


def _record(target: Path) -> set[str]:
    opened: set[str] = set()
    keys: set[str] = set()

    def audit(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and isinstance(arguments[0], str | bytes):
            opened.add(os.path.abspath(os.fsdecode(arguments[0])))  # noqa: PTH100

    def save() -> None:
        telling = {"torch", "torch._dynamo", "otc_dist.learner.learner"}
        modules = sorted(telling & sys.modules.keys())
        target.write_text(
            json.dumps({"opened": sorted(opened), "keys": sorted(keys), "modules": modules})
        )

    # These files are opened by compiled code, which the audit hook does not see.
    import safetensors

    original = safetensors.safe_open

    def safe_open(path, *rest, **named):  # type: ignore[no-untyped-def]
        opened.add(os.path.abspath(os.fsdecode(path)))  # noqa: PTH100
        return original(path, *rest, **named)

    safetensors.safe_open = safe_open
    sys.addaudithook(audit)
    atexit.register(save)
    return keys


def _instrument(faults: dict[str, object], keys: set[str]) -> None:
    from otc_dist.bus import session as module
    from otc_dist.bus.messages import PHASES

    session = module.Session
    delays = random.Random(" ".join(sys.argv))
    sent: Counter[bytes] = Counter()
    hold = list(faults.get("hold", []))  # type: ignore[call-overload]

    def publisher(self, key, original=session.publisher):  # type: ignore[no-untyped-def]
        keys.add(key)
        put = original(self, key)
        last = key.rpartition("/")[2]

        def faulty(payload: bytes) -> None:
            if last == "status":
                put(payload)
                return
            _, _, _, number, deployment, _, step, *_ = msgpack.unpackb(payload)
            phase = next(phase for phase, told in PHASES.items() if told == number)
            if faults.get("kill") == [phase, deployment, step]:
                os.kill(os.getpid(), signal.SIGKILL)
            if hold[:3] == [phase, deployment, step]:
                gate = Path(str(hold[3]))
                hold.clear()
                gate.open().close()  # returns when the test opens its end
            if faults.get("delay"):
                time.sleep(delays.random() * float(faults["delay"]))  # type: ignore[arg-type]
            sent[payload] += 1
            every, seconds = faults.get("late", (0, 0))  # type: ignore[misc]
            if every and len(sent) % every == 0:
                time.sleep(seconds)
            muted = faults.get("mute") and last == "action"
            if not muted and sent[payload] > int(faults.get("drop", 0)):  # type: ignore[call-overload]
                put(payload)

        return faulty

    def noting(name: str):  # type: ignore[no-untyped-def]
        original = getattr(session, name)

        def note(self, key, *rest, **named):  # type: ignore[no-untyped-def]
            keys.add(key)
            return original(self, key, *rest, **named)

        return note

    session.publisher = publisher  # type: ignore[method-assign]
    for name in ("subscribe", "answer", "ask", "ask_all", "declare_alive", "watch_alive"):
        setattr(session, name, noting(name))


def _fill_disk(steps: int) -> None:
    from otc_dist.deployment_log.writer import LogWriter

    original = LogWriter.write

    def write(self, step) -> None:  # type: ignore[no-untyped-def]
        if step.step == steps:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        original(self, step)

    LogWriter.write = write  # type: ignore[method-assign]


def main() -> None:
    record, given, service, *arguments = sys.argv[1:]
    faults = json.loads(given)
    sys.argv = [service, *arguments]
    keys = _record(Path(record))
    if "version" in faults:
        from otc_dist.bus import codec, messages, replies, wire

        for module in (wire, codec, messages, replies):
            module.PROTOCOL_VERSION = faults["version"]  # type: ignore[attr-defined]
    _instrument(faults, keys)
    if faults.get("stub"):
        sys.modules["otc_dist.learner.learner"] = _stub(str(faults["stub"]))
    if faults.get("patient"):
        from otc_dist.services import clock

        clock._MOST = clock._WINDOW
    if "full_disk" in faults:
        _fill_disk(faults["full_disk"])
    runpy.run_module(f"otc_dist.services.{service}", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
