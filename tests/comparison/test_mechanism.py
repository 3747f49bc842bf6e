import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from otc_dist.comparison import perfect
from otc_dist.comparison.frozen_agent import FrozenAgent
from otc_dist.comparison.mechanism import check, table
from otc_dist.comparison.mechanism.pool import successor_errors
from otc_dist.comparison.mechanism.selectors import TENTH
from otc_dist.comparison.mechanism.table import ONLINE, ORACLE, UNIFORM, Estimate, Mechanism
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.description.distances import DISTANCES
from otc_dist.launch.compare import mechanism
from otc_dist.launch.plan import descriptions
from otc_dist.otc.samplers.balanced import BalancedSection
from otc_dist.terminal.errors import UserError

from .conftest import SEEDS, silent

ORACLE_TENTH = f"{ORACLE}, {TENTH}"


@pytest.fixture(scope="module")
def measured(finished: ComparisonFolder, base: Description) -> Mechanism:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check, "POOL", 600)
        patch.setattr(check, "MINIBATCHES", 60)
        for seed in SEEDS:
            check.measure(finished, base, seed, "test", silent)
    return table.read([finished.mechanism("test", seed) for seed in SEEDS])


def test_the_oracle_selects_less_mismatch_and_the_null_row_as_much(measured: Mechanism) -> None:
    rows = {row.name: row for row in measured.rows}
    assert {BalancedSection.row, UNIFORM, ORACLE, ORACLE_TENTH, ONLINE} < set(rows)
    assert rows[ORACLE].mismatch.mean < 0.9
    assert rows[UNIFORM].mismatch.mean == pytest.approx(1, abs=0.03)
    assert rows[ORACLE_TENTH].mismatch.mean < 0.6
    for name, row in rows.items():
        if TENTH in name:
            assert rows[ORACLE_TENTH].mismatch.mean <= row.mismatch.mean
        elif name != ONLINE:
            assert rows[ORACLE].mismatch.mean <= row.mismatch.mean


def test_every_distance_has_a_row_at_alpha_1_and_one_for_its_best_tenth(
    measured: Mechanism,
) -> None:
    names = {row.name for row in measured.rows}
    for facts in DISTANCES.values():
        assert {*(facts.rows or [facts.title]), f"{facts.title}, {TENTH}"} <= names


def test_the_nearer_the_others_are_the_truer_is_the_next_state(measured: Mechanism) -> None:
    error = {row.name: row.error.mean for row in measured.rows}
    assert error[UNIFORM] == pytest.approx(1, abs=0.1)
    assert error[ORACLE] < 0.9 and error[ORACLE_TENTH] < error[ORACLE]
    assert error[ONLINE] < 0.5  # the same policies, by other noise
    in_b_0 = {row.name: row.offline_error.mean for row in measured.rows}
    assert in_b_0[UNIFORM] == pytest.approx(1, abs=0.1) and math.isnan(in_b_0[ONLINE])
    assert error[ORACLE_TENTH] < in_b_0[ORACLE_TENTH] < 0.9  # without D_1's, which are as now
    assert "error of s'" in "\n".join(measured.lines())


def test_the_shares_of_the_newest_data_are_told_apart(measured: Mechanism) -> None:
    """D_1 holds 80 of the 1,280 rows of B_1."""
    rows = {row.name: row for row in measured.rows}
    assert rows[UNIFORM].online.mean == pytest.approx(80 / 1280, abs=0.02)
    assert rows[ONLINE].online.mean == 1
    assert math.isnan(rows[ONLINE].offline.mean)  # none of its rows is B_0's
    assert rows["d_e"].online.mean > 0.1  # they match themselves
    assert rows[UNIFORM].offline.mean == pytest.approx(1, abs=0.03)
    assert rows[ORACLE].offline.mean < 0.95


def test_the_error_of_the_next_state_is_that_of_what_the_others_did(base: Description) -> None:
    joint = store.load_joint(base.dataset.name, base.dataset.transitions)
    now = np.random.default_rng(0).uniform(-1, 1, joint.actions[0].shape).astype(np.float32)
    nothing = np.zeros_like(now)
    gaps = [joint.actions[0] - now, nothing, nothing]
    mine, of_other, _ = successor_errors("hopper-3x1", joint, gaps)
    assert mine.max() < 1e-4  # the others did what was recorded
    simulator = perfect.OneStep("hopper-3x1")
    truth = simulator.play(joint.observations[1], [now, *joint.actions[1:]]).successors[1]
    wrong = (joint.next_observations[1] - truth) / joint.next_observations[1].std(axis=0)
    hit = ~perfect.Correction(simulator, joint).missed
    assert of_other.numpy()[hit] == pytest.approx(np.square(wrong).sum(axis=1)[hit], rel=1e-2)
    assert of_other.median() > 0.01


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
    monkeypatch.setattr(check, "POOL", 600)
    monkeypatch.setattr(check, "MINIBATCHES", 20)
    shares = {}
    for updates in (1, 30, 400):
        changed = base.with_assignments(f"deployment.updates={updates}")
        check.measure(finished, changed, 0, f"{updates}", silent)
        rows = table.read([finished.mechanism(f"{updates}", 0)]).rows
        shares[updates] = next(row.online.mean for row in rows if row.name == BalancedSection.row)
    uniform = 80 / 1280
    assert 0.3 < shares[1] < 0.5
    assert shares[30] == pytest.approx(uniform, abs=0.03)  # all drawn once, nothing learned yet
    assert shares[400] > 2 * uniform


def test_without_a_q_its_rows_and_values_are_left_out(
    finished: ComparisonFolder, base: Description, monkeypatch: pytest.MonkeyPatch
) -> None:
    class WithoutQ(FrozenAgent):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self.critic = None

    monkeypatch.setattr(check, "FrozenAgent", WithoutQ)
    monkeypatch.setattr(check, "POOL", 300)
    monkeypatch.setattr(check, "MINIBATCHES", 3)
    check.measure(finished, base, 0, "without", silent)
    found = table.read([finished.mechanism("without", 0)])
    assert not any(row.name.startswith("d_q") for row in found.rows)
    assert "d_e" in {row.name for row in found.rows}
    text = "\n".join(found.lines())
    assert "V(s')" not in text and "nan" not in text.lower()


def test_where_no_state_can_be_set_the_error_is_left_out(
    finished: ComparisonFolder, base: Description, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(perfect, "possible", lambda env_id: False)
    monkeypatch.setattr(check, "POOL", 300)
    monkeypatch.setattr(check, "MINIBATCHES", 3)
    check.measure(finished, base, 0, "no state", silent)
    text = "\n".join(table.read([finished.mechanism("no state", 0)]).lines())
    head = next(line for line in text.splitlines() if line.startswith("selected by"))
    assert "error" not in head and "mismatch" in head and "nan" not in text.lower()


def test_measuring_again_gives_the_same(finished: ComparisonFolder, base: Description) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check, "POOL", 300)
        patch.setattr(check, "MINIBATCHES", 3)
        for name in ("one", "two"):
            check.measure(finished, base, 0, name, silent)
    one, two = (table.read([finished.mechanism(name, 0)]) for name in ("one", "two"))
    assert [str(row) for row in one.rows] == [str(row) for row in two.rows]


def test_the_label_is_true_of_the_comparison_that_is_looked_into(
    finished: ComparisonFolder,
    base: Description,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Whether it is a quick look was said when the comparison began."""
    monkeypatch.setattr(check, "POOL", 300)
    monkeypatch.setattr(check, "MINIBATCHES", 3)
    check.measure(finished, base, 0, base.digest(), silent)
    described = base.with_assignments("evaluation.episodes=30")
    whole = ComparisonFolder(tmp_path / "whole")
    shutil.copytree(finished.root, whole.root)
    whole.description.write_text(described.to_toml())
    of_both = (whole.mechanism(one.digest(), 0).parent for one in (base, described))
    shutil.copytree(*of_both)
    words = ["3agent_hopper", "--seeds", "0", "--checkpoints"]
    tables = []
    for folder, label in ((finished, f"{descriptions.QUICK_LABEL}\n"), (whole, "")):
        assert mechanism.main([*words, str(folder.root)]) == 0
        said = capsys.readouterr().out
        assert said.startswith(label)
        tables.append(said.removeprefix(label))
    assert tables[0] == tables[1] and descriptions.QUICK_LABEL not in tables[0]
    assert mechanism.main([*words, str(finished.root), "--quick"]) == 0
    with pytest.raises(UserError, match=r"--quick would change pi_0, .* of a whole comparison"):
        mechanism.main([*words, str(whole.root), "--quick"])
    with pytest.raises(UserError, match=r"needs evaluation\.episodes >= 30, not 10"):
        mechanism.main(["3agent_hopper", "--set", "evaluation.episodes=10"])


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
        table.read([path])
