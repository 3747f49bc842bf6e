"""The returns on a run's page: their curve over deployments, and their table."""

from collections.abc import Callable

from otc_dist.report import html, kept
from otc_dist.report.numbers import column, columns, percent, signed
from otc_dist.report.results import Row, Tuned, offline_row, rows, tuned
from otc_dist.report.run_data import RunData
from otc_dist.report.svg import Reference, Series, line_chart


def learning_curve(run: RunData) -> str:
    """Greedy returns over deployments, with the lines that they are to be compared with."""
    table, offline = rows(run), offline_row(run)
    bands = [row.returns.band for row in table]
    series = Series(
        "mean ±1 standard deviation",
        [float(row.deployment) for row in table],
        [row.returns.mean for row in table],
        [low for low, _ in bands],
        [high for _, high in bands],
    )
    references = [
        *([Reference("offline", offline.returns.mean)] if offline else []),
        *([Reference("mean of the data", run.data_return)] if run.data_return is not None else []),
        *([Reference("uniform sampling", run.uniform.greedy_return)] if run.uniform else []),
    ]
    chart = html.chart(
        lambda width, height: line_chart(
            [series],
            title="Return over deployments",
            x_label="deployment",
            y_label="return of greedy episodes",
            references=references,
            x_range=(0, run.description.deployment.total),
            y_range=kept.returns_range(run),
            width=width,
            height=height,
        )
    )
    episodes = run.description.evaluation.episodes
    back = kept.went_back((row.deployment, row.reverted_to) for row in kept.estimates(run))
    return chart + html.note(
        f"Deployment 0 is the policy trained offline. {episodes} greedy episodes each, apart from"
        " the transitions that the agents learn from. The band is of episodes; one run with one"
        f" seed does not show how much runs differ.{' ' * bool(back)}{back}"
    )


def returns_table(run: RunData) -> str:
    """One row an evaluation and their mean; columns that the task has nothing for are left out."""
    table, after = rows(run), tuned(run)
    if not table:
        return ""

    def cells_of(
        of_row: Callable[[Row], float | None],
        of_mean: Callable[[Tuned], float | None] | None = None,
        format_cells: Callable[[list[float | None]], list[str]] = column,
    ) -> list[str]:
        cells = [of_row(row) for row in table]
        if after is None:
            return format_cells(cells)
        return format_cells([*cells, of_mean(after)]) if of_mean else [*format_cells(cells), ""]

    names = ["offline" if row.deployment == 0 else str(row.deployment) for row in table]
    blank = [] if after is None else [""]
    means, *others = columns(
        [*(row.returns.mean for row in table), *([after.mean_return] if after else [])],
        [row.returns.std for row in table],
        [row.returns.minimum for row in table],
        [row.returns.maximum for row in table],
    )
    returns = [means, *([*cells, *blank] for cells in others)]
    listed = {
        "deployment": [*names, *["mean of tuned"] * (after is not None)],
        "episodes": cells_of(lambda row: row.returns.count),
        **dict(zip(("mean", "std", "least", "most"), returns, strict=True)),
        "length": cells_of(lambda row: row.length),
    }
    notes = ["Change: 100 (R_k - R_0) / |R_0|, which explodes where the offline return is near 0."]
    if any(row.score is not None for row in table):
        listed["normalised"] = cells_of(lambda row: row.score, lambda a: a.mean_score)
        listed["its change"] = cells_of(lambda row: row.gain, lambda a: a.gain, _each(signed))
        notes.append("Normalised: 0 is the random policy, 100 the expert.")
    if any(row.success is not None for row in table):
        listed["won"] = cells_of(lambda row: row.success, lambda a: a.mean_success, _each(percent))
        notes.append("Won: share of the episodes.")
    listed["change"] = cells_of(
        lambda row: row.improvement, lambda a: a.improvement, _each(lambda x: signed(x, " %"))
    )
    shown = html.table(list(listed), zip(*listed.values(), strict=True), sums=len(blank))
    return html.section("Returns", shown, html.note(" ".join(notes)))


def _each(format_cells: Callable[[float | None], str]) -> Callable[[list[float | None]], list[str]]:
    return lambda cells: list(map(format_cells, cells))
