import math
from typing import Any

import pytest

from otc_dist.comparison import mechanism, mechanism_table
from otc_dist.comparison.mechanism_table import (
    BALANCED,
    ONLINE,
    ORACLE,
    ROWS,
    UNIFORM,
    Estimate,
    Mechanism,
)
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.comparison.specimen import Specimen
from otc_dist.description import Description
from otc_dist.errors import UserError

from .conftest import SEEDS, silent


@pytest.fixture(scope="module")
def measured(finished: ComparisonFolder, base: Description) -> Mechanism:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mechanism, "POOL", 600)
        patch.setattr(mechanism, "MINIBATCHES", 60)
        for seed in SEEDS:
            mechanism.measure(finished, base, seed, "test", silent)
    return mechanism_table.read([finished.mechanism("test", seed) for seed in SEEDS])


def test_the_oracle_selects_less_mismatch_and_the_null_row_as_much(measured: Mechanism) -> None:
    rows = {row.name: row for row in measured.rows}
    assert list(rows) == list(ROWS)
    assert rows[ORACLE].mismatch.mean < 0.9
    assert rows[UNIFORM].mismatch.mean == pytest.approx(1, abs=0.03)
    for name in ROWS:
        assert rows[ORACLE].mismatch.mean <= rows[name].mismatch.mean or name == ONLINE


def test_the_shares_of_the_newest_data_are_told_apart(measured: Mechanism) -> None:
    """D_1 holds 80 of the 1,280 rows of B_1."""
    rows = {row.name: row for row in measured.rows}
    assert rows[UNIFORM].online.mean == pytest.approx(80 / 1280, abs=0.02)
    assert rows[ONLINE].online.mean == 1
    assert math.isnan(rows[ONLINE].offline.mean)  # none of its rows is B_0's
    assert rows["d_e"].online.mean > 0.1  # they match themselves
    assert rows[UNIFORM].offline.mean == pytest.approx(1, abs=0.03)
    assert rows[ORACLE].offline.mean < 0.95


def test_what_was_just_deployed_matches_the_policies_best(measured: Mechanism) -> None:
    """Recorded actions in D_1 are the policies' own, up to the noise of decoding."""
    online = next(row for row in measured.rows if row.name == ONLINE)
    assert online.mismatch.mean < 0.5


def test_what_was_measured_is_told(measured: Mechanism) -> None:
    assert (measured.seeds, measured.agents) == (2, 3)
    assert (measured.pool, measured.minibatches) == (600, 60)
    text = "\n".join(measured.lines())
    assert "2 seeds x 3 agents; 60 minibatches each, from a random 600 rows" in text


def test_balanced_replay_selects_what_its_density_ratio_has_learned(
    finished: ComparisonFolder, base: Description, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The newest data come with a priority of half of all. What they have after L updates is what
    w, which learned from them, gives them.
    """
    monkeypatch.setattr(mechanism, "POOL", 600)
    monkeypatch.setattr(mechanism, "MINIBATCHES", 20)
    shares = {}
    for updates in (1, 30, 400):
        changed = base.with_assignments(f"deployment.updates={updates}")
        mechanism.measure(finished, changed, 0, f"{updates}", silent)
        rows = mechanism_table.read([finished.mechanism(f"{updates}", 0)]).rows
        shares[updates] = next(row.online.mean for row in rows if row.name == BALANCED)
    uniform = 80 / 1280
    assert 0.3 < shares[1] < 0.5
    assert shares[30] == pytest.approx(uniform, abs=0.03)  # all drawn once, nothing learned yet
    assert shares[400] > 2 * uniform


def test_without_a_q_its_rows_and_values_are_left_out(
    finished: ComparisonFolder, base: Description, monkeypatch: pytest.MonkeyPatch
) -> None:
    class WithoutQ(Specimen):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self.critic = None

    monkeypatch.setattr(mechanism, "Specimen", WithoutQ)
    monkeypatch.setattr(mechanism, "POOL", 300)
    monkeypatch.setattr(mechanism, "MINIBATCHES", 3)
    mechanism.measure(finished, base, 0, "without", silent)
    found = mechanism_table.read([finished.mechanism("without", 0)])
    names = [row.name for row in found.rows]
    assert names == [name for name in ROWS if not name.startswith("d_q")]
    text = "\n".join(found.lines())
    assert "V(s')" not in text and "nan" not in text.lower()


def test_measuring_again_gives_the_same(finished: ComparisonFolder, base: Description) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mechanism, "POOL", 300)
        patch.setattr(mechanism, "MINIBATCHES", 3)
        for name in ("one", "two"):
            mechanism.measure(finished, base, 0, name, silent)
    one, two = (mechanism_table.read([finished.mechanism(name, 0)]) for name in ("one", "two"))
    assert [str(row) for row in one.rows] == [str(row) for row in two.rows]


def test_the_standard_error_by_hand() -> None:
    estimate = Estimate.of([1.0, 2.0, 3.0, 6.0])
    assert estimate.mean == 3
    assert estimate.error == pytest.approx(math.sqrt((4 + 1 + 0 + 9) / 3) / 2)
    assert str(Estimate.of([1.5])) == "1.500"


def test_a_damaged_file_is_one_clear_line(finished: ComparisonFolder) -> None:
    path = finished.mechanism("damaged", 0)
    path.parent.mkdir(parents=True)
    path.write_text("{}")
    with pytest.raises(UserError, match="damaged"):
        mechanism_table.read([path])
