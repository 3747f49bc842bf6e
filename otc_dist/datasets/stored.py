"""What lies in others' files: how much memory it may take, and its digest."""

from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path

from otc_dist.datasets.card import file_sha256

_LARGEST_RATIO = 1100  # of the bytes of arrays to those that are stored: Deflate's is 1,032
_UNSTORED = 2**16  # bytes of arrays that need not be stored, as those of one that has none


def most(stored: int) -> int:
    """Bytes that arrays can take of which `stored` bytes are there."""
    return _UNSTORED + _LARGEST_RATIO * stored


def regular_files(folder: Path, pattern: str = "**/*") -> list[Path]:
    """The files in a folder by their names; no links, which may lead anywhere."""
    return sorted(p for p in folder.glob(pattern) if p.is_file() and not p.is_symlink())


def files_sha256(folder: Path, files: Iterable[Path]) -> str:
    """Of these files in a folder, with their names."""
    digest = sha256()
    for path in files:
        name = path.relative_to(folder).as_posix()
        digest.update(f"{name} {file_sha256(path)}\n".encode(errors="surrogateescape"))
    return digest.hexdigest()
