"""A short form of `launch chaos`: faults of several kinds strike one run, which ends the same."""

from pathlib import Path

import pytest

from otc_dist.errors import UserError
from otc_dist.launch.__main__ import main


@pytest.mark.parametrize(
    ("faults", "says"),
    [(["kill-hots=1"], "did you mean 'kill-host'?"), (["freeze"], "write it as freeze=20")],
)
def test_a_mistake_is_one_line(faults: list[str], says: str) -> None:
    with pytest.raises(UserError) as caught:
        main(["chaos", *faults])
    assert says in str(caught.value)


@pytest.mark.slow
def test_whatever_strikes_the_run_ends_with_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("otc_dist.launch.chaos_arena.enter", lambda: None)  # it would leave pytest
    assert main(["chaos", "any=2", "--out", str(tmp_path)]) == 0
    fault, struck, runs, identical, *_ = capsys.readouterr().out.splitlines()[-1].split()
    assert (fault, struck) == ("any", "2")
    assert runs == identical
    assert not (tmp_path / "wrong").exists()
