"""One lock-step as one MCAP message: a msgpack map whose fields lie at fixed offsets.

Sizes are fixed by the team and the number of copies, so every record of a log has the same
length. Writing one is copying arrays into a template; reading many is a view of the bytes as
structured rows; and finding the next record after damage is a search for the same few bytes.

The payload is the map of `payload_schema`. Its last field is the CRC-32 of all the bytes before
that field's 5 bytes (0xce and the checksum, big-endian), begun with the log's binding: neither a
torn or flipped record nor one of another log passes.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from otc_dist.deployment_log.format import MAXIMUM_RECORD
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, JointStep, Transitions

CHANNEL_ID = 1
MESSAGE_OPCODE = 5

# https://mcap.dev/spec#message-op0x05: opcode, length | channel, sequence, log and publish time
_FRAME = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_PREFIX_SIZE = _FRAME.size + 2  # opcode, length, channel: the same in all records of a log
_TIMES = struct.Struct("<IQQ")
PAYLOAD_START = _FRAME.size + _MESSAGE.size
_CHECKSUM = struct.Struct(">I")
_UINT32 = b"\xce"  # msgpack's marker; always this width, so that the length never varies
_FALSE = 0xC2  # msgpack's false; true is one more

PER_AGENT = ("observations", "actions", "rewards", "next_observations")

Rows = NDArray[np.void]  # structured; one row per step, fields as in `RecordLayout.dtype`


class RecordLayout:
    """The record of a team of N agents in E copies.

    Args:
        binding: what the checksums begin with; see `LogHeader.binding`.
        timed: whether steps say which deadlines were missed; see `LogHeader.timed`.

    Raises:
        UserError: one step of so many copies does not fit into a record.
    """

    def __init__(self, team: TeamSpec, copies: int, binding: int, timed: bool = False) -> None:
        self.team, self.copies, self.binding, self.timed = team, copies, binding, timed
        self.shapes: dict[str, list[tuple[int, ...]]] = {
            "observations": [(copies, agent.observation_size) for agent in team.agents],
            "actions": [(copies, agent.action_size) for agent in team.agents],
            "rewards": [(copies,) for _ in team.agents],
            "next_observations": [(copies, agent.observation_size) for agent in team.agents],
        }
        time = np.dtype("<u8")  # ns since the epoch
        self._fields: dict[str, tuple[np.dtype[Any], tuple[int, ...], int]] = {
            "log_time": (time, (), _PREFIX_SIZE + 4),
            "publish_time": (time, (), _PREFIX_SIZE + 12),
        }
        # Before anything of that size is made: the numbers may come from somebody else's file.
        numbers = sum(2 * agent.observation_size + agent.action_size + 1 for agent in team.agents)
        if (about := copies * (4 * numbers + 8 * team.state_size)) > MAXIMUM_RECORD:
            raise _too_large(copies, about)
        payload = self._payload()
        self.size = PAYLOAD_START + len(payload)
        if self.size > MAXIMUM_RECORD:
            raise _too_large(copies, self.size)
        frame = _FRAME.pack(MESSAGE_OPCODE, self.size - _FRAME.size)
        self.template = frame + _MESSAGE.pack(CHANNEL_ID, 0, 0, 0) + payload
        self.prefix = self.template[:_PREFIX_SIZE]
        self.dtype = np.dtype(
            {
                "names": list(self._fields),
                "formats": [(dtype, shape) for dtype, shape, _ in self._fields.values()],
                "offsets": [offset for _, _, offset in self._fields.values()],
                "itemsize": self.size,
            }
        )

    def _payload(self) -> bytearray:
        """An all-zero payload, noting on the way where each field's data lie."""
        out, pack = bytearray(), msgpack.Packer()

        def binary(name: str, dtype: str, shape: tuple[int, ...]) -> None:
            kind = np.dtype(dtype)
            size = kind.itemsize * int(np.prod(shape))
            out.extend(pack.pack(bytes(size)))
            self._fields[name] = (kind, shape, PAYLOAD_START + len(out) - size)

        def integer(name: str) -> None:
            out.extend(_UINT32 + bytes(4))
            self._fields[name] = (np.dtype(">u4"), (), PAYLOAD_START + len(out) - 4)

        def flags(name: str, count: int) -> None:
            self._fields[name] = (np.dtype("u1"), (count,), PAYLOAD_START + len(out))
            out.extend(bytes([_FALSE]) * count)

        out.extend(pack.pack_map_header(len(PER_AGENT) + 7 + 2 * self.timed))
        out.extend(pack.pack("step"))
        integer("step")
        for name in PER_AGENT:
            out.extend(pack.pack(name) + pack.pack_array_header(len(self.team.agents)))
            for agent, shape in enumerate(self.shapes[name]):
                binary(f"{name}.{agent}", "<f4", shape)
        for name in ("terminated", "truncated"):
            out.extend(pack.pack(name))
            binary(name, "?", (self.copies,))
        agents = len(self.team.agents)
        out.extend(pack.pack("exploring") + pack.pack_array_header(agents))
        flags("exploring", agents)
        out.extend(pack.pack("episode_seeds"))
        binary("episode_seeds", "<i8", (self.copies,))
        out.extend(pack.pack("state"))
        binary("state", "<f8", (self.copies, self.team.state_size))
        if self.timed:
            out.extend(pack.pack("held") + pack.pack_array_header(agents))
            flags("held", agents)
            out.extend(pack.pack("late"))
            flags("late", 1)
        out.extend(pack.pack("crc32"))
        integer("crc32")
        return out

    def intact(self, data: bytes | memoryview, first_step: int) -> int:
        """How many records at the start of `data` are whole, unchanged and in order of steps."""
        view, size, prefix = memoryview(data), self.size, self.prefix
        step_at = self._fields["step"][2]
        end = size - 1 - _CHECKSUM.size  # of what the checksum covers
        for count in range(len(view) // size):
            record = view[count * size : (count + 1) * size]
            step = first_step + count
            if (
                record[:_PREFIX_SIZE] != prefix
                or record[end] != _UINT32[0]
                or _CHECKSUM.unpack_from(record, end + 1)[0]
                != zlib.crc32(record[PAYLOAD_START:end], self.binding)
                or _TIMES.unpack_from(record, _PREFIX_SIZE)[0] != step
                or _CHECKSUM.unpack_from(record, step_at)[0] != step
            ):
                return count
        return len(view) // size

    def step_of(self, record: bytes) -> int | None:
        """The number of the step in one record; None if it is not whole and unchanged."""
        if len(record) != self.size:
            return None
        step = int(_CHECKSUM.unpack_from(record, self._fields["step"][2])[0])
        return step if self.intact(record, step) else None

    def rows(self, data: bytes | bytearray | memoryview) -> Rows:
        """Intact records as structured rows; a view of `data`."""
        return np.frombuffer(data, self.dtype)

    def steps(self, rows: Rows) -> Iterator[JointStep]:
        """Rows as steps. Arrays are aligned and writable; those of one block share memory."""
        column = {name: np.array(rows[name]) for name in self.dtype.names or ()}
        agents = range(len(self.team.agents))
        by_agent = [[column[f"{name}.{i}"] for i in agents] for name in PER_AGENT]
        exploring, held = self.exploring(rows).tolist(), self.held(rows).tolist()
        late = self.late(rows).tolist()
        for t, step in enumerate(column["step"].tolist()):
            observations, actions, rewards, next_observations = (
                tuple([array[t] for array in arrays]) for arrays in by_agent
            )
            yield JointStep(
                step=step,
                observations=observations,
                actions=actions,
                rewards=rewards,
                next_observations=next_observations,
                terminated=column["terminated"][t],
                truncated=column["truncated"][t],
                exploring=tuple(exploring[t]),
                episode_seeds=column["episode_seeds"][t],
                state=column["state"][t],
                held=tuple(held[t]),
                late=late[t],
            )

    def exploring(self, rows: Rows) -> Bool:
        """Behaviour tags (T, N): which agents explored."""
        tags: Bool = np.array(rows["exploring"]) != _FALSE
        return tags

    def held(self, rows: Rows) -> Bool:
        """Whose actions before were held, (T, N); (T, 0) where no clock was kept."""
        if not self.timed:
            return np.zeros((len(rows), 0), np.bool_)
        held: Bool = np.array(rows["held"]) != _FALSE
        return held

    def late(self, rows: Rows) -> Bool:
        """Whether what the step brought came late, (T,); nowhere where no clock was kept."""
        if not self.timed:
            return np.zeros(len(rows), np.bool_)
        late: Bool = np.array(rows["late"])[:, 0] != _FALSE
        return late

    def transitions(self, rows: Rows, agent: int) -> Transitions:
        """T rows as the T * E transitions of one agent: by step, then by copy. Fresh arrays."""
        count, spec = len(rows) * self.copies, self.team.agents[agent]

        def flat(name: str, *size: int) -> NDArray[Any]:
            return np.array(rows[name]).reshape(count, *size)

        return Transitions(
            observations=flat(f"observations.{agent}", spec.observation_size),
            actions=flat(f"actions.{agent}", spec.action_size),
            rewards=flat(f"rewards.{agent}"),
            next_observations=flat(f"next_observations.{agent}", spec.observation_size),
            terminated=flat("terminated"),
            truncated=flat("truncated"),
        )


def _too_large(copies: int, size: int) -> UserError:
    return UserError(
        f"env.copies = {copies} makes log records of {size / 2**20:.0f} MiB;"
        f" at most {MAXIMUM_RECORD / 2**20:.0f} MiB are allowed"
    )


class StepEncoder:
    """Encodes steps: the template's constant bytes, joined with the bytes of a step's arrays."""

    def __init__(self, layout: RecordLayout) -> None:
        self._prefix, self._agents = layout.prefix, len(layout.team.agents)
        self._binding, self._flagged = layout.binding, self._agents if layout.timed else 0
        fields = layout.dtype.fields
        assert fields is not None  # it is a structured type
        names = [name for name in fields if name not in ("log_time", "publish_time", "crc32")]
        # Constant bytes in the even places, fields in the odd ones; the checksum is added last.
        self._parts: list[bytes] = []
        self._shapes: list[tuple[int, ...]] = []  # of the arrays, in their order
        self._types: list[np.dtype[Any]] = []
        end = PAYLOAD_START
        for name in names:
            kind, start = fields[name][0], int(fields[name][1])
            self._parts += [bytes(layout.template[end:start]), b""]
            end = start + kind.itemsize
            if name not in ("step", "exploring", "held", "late"):
                self._shapes.append(kind.shape)
                self._types.append(kind.base)
        self._parts.append(bytes(layout.template[end : -1 - _CHECKSUM.size]))
        self._exploring = 1 + 2 * names.index("exploring")

    def encode(self, step: JointStep, log_time: int) -> bytes:
        """The whole MCAP record.

        Raises:
            ValueError: an array has another shape than the team's.
            TypeError: an array has another type than the team's.
        """
        arrays = [
            *step.observations,
            *step.actions,
            *step.rewards,
            *step.next_observations,
            step.terminated,
            step.truncated,
            step.episode_seeds,
            step.state,
        ]
        if (shapes := [array.shape for array in arrays]) != self._shapes:
            raise ValueError(f"a step's arrays have shapes {shapes}, not {self._shapes}")
        if (types := [array.dtype for array in arrays]) != self._types:
            raise TypeError(f"a step's arrays are of {types}, not {self._types}")
        if len(step.exploring) != self._agents:
            raise ValueError(f"a step has {len(step.exploring)} behaviour tags")
        if len(step.held) != self._flagged:
            raise ValueError(f"a step says of {len(step.held)} agents whose actions were held")
        parts, exploring = self._parts, self._exploring
        data = [array.tobytes() for array in arrays]
        parts[1] = _CHECKSUM.pack(step.step)
        parts[3:exploring:2] = data[:-2]
        parts[exploring] = _flags(step.exploring)
        parts[exploring + 2 : exploring + 6 : 2] = data[-2:]
        if self._flagged:
            parts[exploring + 6 :: 2] = [_flags(step.held), _flags((step.late,))]
        body = b"".join(parts)
        times = _TIMES.pack(step.step, log_time, log_time)
        checksum = _CHECKSUM.pack(zlib.crc32(body, self._binding))
        return b"".join((self._prefix, times, body, _UINT32, checksum))


def _flags(values: tuple[bool, ...]) -> bytes:
    return bytes([_FALSE + value for value in values])
