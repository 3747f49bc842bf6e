from pathlib import Path

from otc_dist.processor import processor


def test_the_processor_is_told_with_the_instructions_that_matter(tmp_path: Path) -> None:
    told = tmp_path / "cpuinfo"
    told.write_text(
        "processor\t: 0\nmodel name\t: Made Up 7\nflags\t\t: fpu fma avx2 pae\n\n"
        "processor\t: 1\nmodel name\t: Made Up 7\nflags\t\t: fpu fma avx2 pae\n"
    )
    assert processor(told) == "Made Up 7 (avx2 fma)"


def test_a_system_that_does_not_say_is_no_fault(tmp_path: Path) -> None:
    assert processor(tmp_path / "none") != ""
