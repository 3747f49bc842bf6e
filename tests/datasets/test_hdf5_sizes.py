"""An HDF5 file is read only as far as what is stored in it can account for, and no other is."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from otc_dist.datasets import hdf5
from otc_dist.datasets.importers import import_files
from otc_dist.terminal.errors import UserError

Make = Callable[[h5py.File, Path], object]


def unwritten(file: h5py.File, folder: Path) -> None:
    file.create_dataset("observations", (10**9, 11), "f4", chunks=(1000, 11), compression="gzip")


def packed_twice(file: h5py.File, folder: Path) -> None:
    """A chunk that inflates by gzip's ratio, and a billion more rows that were never written."""
    made = file.create_dataset("observations", (10**9, 11), "f4", chunks=(10**5, 11), compression=9)
    made[: 10**5] = 0


def virtual(file: h5py.File, folder: Path) -> None:
    layout = h5py.VirtualLayout((10**9, 11), "f4")
    layout[:] = h5py.VirtualSource(str(folder / "other.hdf5"), "x", (10**9, 11))
    file.create_virtual_dataset("observations", layout)


def external(file: h5py.File, folder: Path) -> None:
    secret = [(str(folder / "secret"), 0, 44)]
    file.create_dataset("observations", (1, 11), "f4", external=secret)


def linked(file: h5py.File, folder: Path) -> None:
    with h5py.File(folder / "other.hdf5", "w") as other:
        other["x"] = np.ones((3, 11), np.float32)
    file["observations"] = h5py.ExternalLink(str(folder / "other.hdf5"), "x")


@pytest.mark.parametrize("make", [unwritten, packed_twice, virtual, external, linked])
def test_what_is_not_in_the_file_is_not_read(make: Make, tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(bytes(44))
    path = tmp_path / "hopper.hdf5"
    with h5py.File(path, "w") as file:
        make(file, tmp_path)
        for name in ("actions", "rewards", "terminals"):
            file[name] = np.zeros(3, np.float32)
    assert path.stat().st_size < 2**16
    with pytest.raises(UserError, match=f"{path}: observations") as caught:
        import_files([path], "mine", "hopper-3x1")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("settings", [{}, {"compression": 9, "shuffle": True}])
def test_what_compresses_well_is_read(settings: dict[str, object], tmp_path: Path) -> None:
    path, wide = tmp_path / "a.hdf5", np.zeros((10**5, 11), np.float32)
    with h5py.File(path, "w") as file:
        file.create_dataset("wide", data=wide, **settings)
        file.create_dataset("none", (0, 11), "f4")
    with hdf5.opened(path) as file:
        found = hdf5.array(file, "wide", "a"), hdf5.array(file, "none", "a")
    assert found[0] is not None and np.array_equal(found[0], wide)
    assert found[1] is not None and found[1].shape == (0, 11)
