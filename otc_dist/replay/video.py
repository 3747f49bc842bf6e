"""`--video OUT.mp4`: a deployment's best and worst episode as a film, at the task's own pace."""

import argparse
from fractions import Fraction
from pathlib import Path

import numpy as np

from otc_dist.replay.output import claimed
from otc_dist.replay.timeline import highlights
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import say
from otc_dist.terminal.progress import shown

_RATE = 30  # frames a second, at most about
_QUALITY = "20"  # x264's constant rate factor: smaller is better


def run(arguments: argparse.Namespace) -> int:
    """Write the film of the best and then the worst episode, or of the selected steps."""
    try:
        import av

        from otc_dist.replay.frames import HEIGHT, WIDTH, renderer
    except ModuleNotFoundError as error:
        raise missing(error) from None
    out, timelines = Path(arguments.video), highlights(arguments)
    scene = timelines[0][1].scene
    with claimed(out, force=arguments.force, reads=arguments.files) as path:
        seconds = Fraction(scene.seconds if scene else 1).limit_denominator(10_000)
        every = max(1, round(1 / (_RATE * seconds)))  # steps per frame
        total = sum(len(range(0, len(timeline), every)) for _, timeline in timelines)
        with av.open(path, "w", format="mp4") as film, shown(out.name, "frames") as report:
            stream = film.add_stream("libx264", rate=1 / (every * seconds))
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            stream.options = {"crf": _QUALITY, "preset": "veryfast"}
            done = 0
            for title, timeline in timelines:
                with renderer(timeline, title) as render:
                    for i in range(0, len(timeline), every):
                        picture = np.asarray(render(i))
                        frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
                        film.mux(stream.encode(frame))
                        done += 1
                        report(done, total)
            film.mux(stream.encode())
    say(out)
    return 0


def missing(error: ModuleNotFoundError) -> UserError:
    """The one line for someone who has not installed what pictures need."""
    return UserError(f"this needs the package {error.name}: {install('video')}")
