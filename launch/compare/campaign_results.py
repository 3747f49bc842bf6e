"""What a campaign's folder shows: its page, and its tables as text."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from otc_dist.comparison.campaign import found, page, tables, verdicts
from otc_dist.comparison.campaign.found import Found
from otc_dist.comparison.campaign.published import Published
from otc_dist.comparison.campaign.verdicts import Verdict

from . import campaign_file
from .campaign_file import Campaign
from .command import lines
from .comparison import label_of

PAGE = "campaign.html"


@dataclass(frozen=True)
class Results:
    """Of one folder, by the campaigns' files that lie in it beside the scores.

    A folder may hold the scores of several campaigns, whose parts have different names.

    Attributes:
        folders: of all comparisons; `found` are those with scores.
        left_out: what looks like a campaign's, and is none: other TOML files, and runs.
    """

    root: Path
    folders: Sequence[Path]
    found: Sequence[Found]
    published: Published | None
    judged: Sequence[Verdict]
    left_out: Sequence[Path]

    @classmethod
    def read(cls, root: Path, others: Iterable[Path] = ()) -> "Results":
        """Of `others`, files of campaigns, the claims are shown as well if they lie elsewhere.

        Raises:
            UserError: it is no campaign's folder, or a file in it is wrong.
        """
        folders, files = found.folders(root), {*root.glob("*.toml")}
        listing = {path for path in files if campaign_file.is_campaign(path)}
        described = {path.parent for path in root.glob("*/description.toml")}
        left_out = sorted((files - listing) | (described - {*folders}))
        campaigns = together([*others, *listing]).values()
        several = found.read(folders)
        published = Published.together([one.published for one in campaigns if one.published])
        figures = [figure for one in campaigns for figure in one.figures]
        judged = [verdicts.judge(figure, several, published) for figure in figures]
        return cls(root, folders, several, published, judged, left_out)

    def text(self) -> Iterator[str]:
        """The tables of every comparison; then those of all together, and what is reproduced."""
        scores = {one.name: one.scores for one in self.found}
        for name in (folder.name for folder in self.folders):
            if name in scores:
                yield from (f"{name}:", *lines(scores[name]), "")
            else:
                yield from (f"{name}: no seed is complete yet", "")
        yield "all together:"
        yield from self.together()

    def together(self) -> Iterator[str]:
        """The tables of all together, and what is reproduced."""
        yield from tables.text(self.found, self.published)
        if self.judged:
            yield ""
            yield from verdicts.lines(self.judged)

    def page(self) -> str:
        """The HTML document."""
        labels = (label_of(one.scores.quick, one.scores.episodes) for one in self.found)
        label = next(filter(None, labels), "")
        title = f"Campaign: {self.root.name}"
        return page.page(title, self.found, self.judged, self.published, label)


def together(files: Iterable[Path]) -> dict[str, Campaign]:
    """Campaigns by name, of several with the same name the last; those that quote numbers come
    first. Raises UserError: one cannot be read.
    """
    by_name = {path.stem: path for path in files}
    campaigns = [(name, Campaign.load(by_name[name])) for name in sorted(by_name)]
    return dict(sorted(campaigns, key=lambda one: one[1].published is None))
