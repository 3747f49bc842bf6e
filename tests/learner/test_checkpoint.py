"""Checkpoints: read back to the bit, or refused in one line."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from otc_dist.learner import checkpoint
from otc_dist.terminal.errors import UserError

ARRAYS = {
    "algorithm.actor": np.linspace(-1, 1, 12, dtype=np.float32),
    "algorithm.updates": np.array(7.0),
}
PROGRESSED = checkpoint.CheckpointMetadata("agent_1", "offline", "run", 60_000, 3, 1.25, 0.5)


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "folder" / "checkpoint_03.safetensors"
    checkpoint.write(path, ARRAYS, PROGRESSED)
    return path


def refusal(path: Path) -> str:
    with pytest.raises(UserError) as caught:
        checkpoint.read(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    return str(caught.value)


def test_what_is_written_is_read(written: Path) -> None:
    arrays, progressed = checkpoint.read(written)
    assert progressed == PROGRESSED
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype and np.array_equal(arrays[name], array)


def test_not_a_number_survives(tmp_path: Path) -> None:
    """The similarity before the first deployment."""
    fresh = checkpoint.CheckpointMetadata("agent_1", "offline", "run", 0, -1, 1.0, float("nan"))
    checkpoint.write(tmp_path / "c", ARRAYS, fresh)
    assert np.isnan(checkpoint.read(tmp_path / "c")[1].similarity)


def test_equal_content_gives_equal_bytes(written: Path, tmp_path: Path) -> None:
    backwards = dict(reversed(ARRAYS.items()))
    checkpoint.write(tmp_path / "again", backwards, PROGRESSED)
    assert (tmp_path / "again").read_bytes() == written.read_bytes()


def test_every_flipped_bit_of_any_byte_is_noticed(written: Path) -> None:
    content = written.read_bytes()
    for position in range(len(content)):
        damaged = bytearray(content)
        damaged[position] ^= 1 << (position % 8)
        written.write_bytes(damaged)
        refusal(written)


def test_every_truncation_is_noticed(written: Path) -> None:
    content = written.read_bytes()
    for length in range(0, len(content), 7):
        written.write_bytes(content[:length])
        assert "damaged" in refusal(written)


def test_a_changed_counter_is_noticed(written: Path) -> None:
    """A header that is well-formed but says something else."""
    content = written.read_bytes()
    for before, after in ((b"1.25", b"9.25"), (b"agent_1", b"agent_2"), (b"60000", b"70000")):
        assert before in content
        written.write_bytes(content.replace(before, after))
        assert "digest" in refusal(written)


@pytest.mark.parametrize("metadata", [None, {}, {"otc_dist": "[1]"}, {"otc_dist": '"x"'}])
def test_other_safetensors_files_are_refused(tmp_path: Path, metadata: object) -> None:
    header = json.dumps({} if metadata is None else {"__metadata__": metadata}).encode()
    (tmp_path / "other").write_bytes(struct.pack("<Q", len(header)) + header)
    assert "damaged" in refusal(tmp_path / "other")


def test_a_newer_format_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "FORMAT", 2)
    checkpoint.write(tmp_path / "new", ARRAYS, PROGRESSED)
    monkeypatch.undo()
    assert "format 2; this version reads 1" in refusal(tmp_path / "new")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert "no checkpoint" in refusal(tmp_path / "absent")


def test_a_failed_write_leaves_the_old_checkpoint(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    before = written.read_bytes()
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(UserError, match="No space left on device"):
        checkpoint.write(written, {"other": np.zeros(3)}, PROGRESSED)
    assert written.read_bytes() == before
    assert [path.name for path in written.parent.iterdir()] == [written.name]


def test_digest_tells_names_shapes_types_and_values_apart() -> None:
    x = np.arange(6, dtype=np.float32)
    variants = [
        {"a": x},
        {"b": x},
        {"a": x.reshape(2, 3)},
        {"a": x.view(np.int32)},
        {"a": x + 1},
        {"a": x, "b": x},
    ]
    assert len({checkpoint.digest(arrays) for arrays in variants}) == len(variants)
    assert checkpoint.digest({"a": x, "b": x}) == checkpoint.digest({"b": x.copy(), "a": x})
