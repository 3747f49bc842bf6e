import os
from pathlib import Path

import pytest

from otc_dist.system.processor import kind, libraries, processor


def test_the_processor_is_told_with_the_instructions_that_matter(tmp_path: Path) -> None:
    path = tmp_path / "cpuinfo"
    path.write_text(
        "processor\t: 0\nmodel name\t: Made Up 7\nflags\t\t: fpu fma avx2 pae\n\n"
        "processor\t: 1\nmodel name\t: Made Up 7\nflags\t\t: fpu fma avx2 pae\n"
    )
    assert processor(path) == "Made Up 7 (avx2 fma)"


def test_a_system_that_does_not_say_is_no_fault(tmp_path: Path) -> None:
    assert processor(tmp_path / "none") != ""


def test_settings_that_choose_other_kernels_make_another_kind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = kind()
    monkeypatch.setenv("MKL_CBWR", "COMPATIBLE")
    assert before.startswith(processor()) and "COMPATIBLE" not in before
    assert "MKL_CBWR=COMPATIBLE" in kind()


def test_the_libraries_that_compute_are_told_by_their_paths() -> None:
    import numpy as np

    np.ones((2, 2)) @ np.ones((2, 2))
    libraries_found = [path.rpartition("/")[2] for path in libraries(os.getpid())]
    assert any("openblas" in name for name in libraries_found)
    assert any(name.startswith("libm") for name in libraries_found)
    assert not any("zstd" in name or "python" in name for name in libraries_found)
    assert libraries(2**22 + 1) == ()  # no such process
