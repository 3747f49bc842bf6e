"""`--sheet OUT.png`: a deployment at a glance, twelve moments of it on one sheet."""

import argparse
from pathlib import Path

import numpy as np

from otc_dist.progress import shown
from otc_dist.replay.output import claimed
from otc_dist.replay.tape import selected_tape
from otc_dist.replay.video import missing

_COLUMNS, _ROWS = 3, 4
_GAP = 8  # px


def run(arguments: argparse.Namespace) -> int:
    """Write the sheet of the selected steps and say where it is."""
    try:
        from PIL import Image

        from otc_dist.replay.painter import HEIGHT, WIDTH, painter
    except ModuleNotFoundError as error:
        raise missing(error) from None
    out, tape = Path(arguments.sheet), selected_tape(arguments)
    # The first and the last step, and evenly between them.
    moments = np.unique(np.rint(np.linspace(0, len(tape) - 1, _COLUMNS * _ROWS)).astype(int))
    rows = -(-len(moments) // _COLUMNS)
    size = (_COLUMNS * (WIDTH + _GAP) + _GAP, rows * (HEIGHT + _GAP) + _GAP)
    sheet = Image.new("RGB", size, (200, 205, 211))
    with claimed(out, force=arguments.force) as path:
        with painter(tape) as paint, shown(out.name, "pictures") as report:
            for n, i in enumerate(moments.tolist()):
                place = (n % _COLUMNS, n // _COLUMNS)
                corner = (_GAP + place[0] * (WIDTH + _GAP), _GAP + place[1] * (HEIGHT + _GAP))
                sheet.paste(paint(i), corner)
                report(n + 1, len(moments))
        half = (size[0] // 2, size[1] // 2)
        sheet.resize(half, Image.Resampling.LANCZOS).save(path, "png")
    print(out)
    return 0
