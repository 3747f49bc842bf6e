"""`--sheet OUT.png`: a deployment at a glance, twelve moments of its best and worst episode."""

import argparse
from pathlib import Path

import numpy as np

from otc_dist.replay.output import claimed
from otc_dist.replay.timeline import highlights
from otc_dist.replay.video import missing
from otc_dist.terminal.printable import say
from otc_dist.terminal.progress import shown

_COLUMNS, _ROWS = 3, 4
_GAP = 8  # px


def run(arguments: argparse.Namespace) -> int:
    """Write the sheet of the best and the worst episode, or of the selected steps."""
    try:
        from PIL import Image

        from otc_dist.replay.frames import HEIGHT, WIDTH, renderer
    except ModuleNotFoundError as error:
        raise missing(error) from None
    out, timelines = Path(arguments.sheet), highlights(arguments)
    each = _COLUMNS * _ROWS // len(timelines)
    # Of each the first and the last step, and evenly between them.
    moments = [
        np.unique(np.rint(np.linspace(0, len(t) - 1, each)).astype(int)) for _, t in timelines
    ]
    firsts = np.cumsum([0, *(-(-len(of_one) // _COLUMNS) for of_one in moments)]).tolist()
    *firsts, rows = firsts  # rows at which they begin, and how many there are
    size = (_COLUMNS * (WIDTH + _GAP) + _GAP, rows * (HEIGHT + _GAP) + _GAP)
    sheet = Image.new("RGB", size, (200, 205, 211))
    with claimed(out, force=arguments.force, reads=arguments.files) as path:
        with shown(out.name, "pictures") as report:
            done, total = 0, sum(map(len, moments))
            for (title, timeline), of_one, first in zip(timelines, moments, firsts, strict=True):
                with renderer(timeline, title) as render:
                    for n, i in enumerate(of_one.tolist()):
                        column, row = n % _COLUMNS, first + n // _COLUMNS
                        corner = (_GAP + column * (WIDTH + _GAP), _GAP + row * (HEIGHT + _GAP))
                        sheet.paste(render(i), corner)
                        done += 1
                        report(done, total)
        half = (size[0] // 2, size[1] // 2)
        sheet.resize(half, Image.Resampling.LANCZOS).save(path, "png")
    say(out)
    return 0
