"""The command `python -m otc_dist.datasets`: list, make, show and import data sets."""

import argparse
from pathlib import Path

from otc_dist.datasets import store
from otc_dist.datasets.card import DatasetCard, Summary
from otc_dist.datasets.importers import import_files
from otc_dist.datasets.names import DatasetName, known_names
from otc_dist.description import user_code
from otc_dist.system.cache import cache_root
from otc_dist.terminal import progress
from otc_dist.terminal.errors import run_main
from otc_dist.terminal.parser import Parser
from otc_dist.terminal.printable import aligned, say

DESCRIPTION = """\
Offline data sets B_0: one file per agent, with only that agent's <s, a_i, r, s'>.

Data sets we make have the name ENVIRONMENT/LEVEL, where LEVEL is
  random          uniformly random actions
  medium          samples of a behaviour policy; of a robot, of D4RL's medium level
  medium-replay   a mixture of the policies on the way there, from the untrained one on
Robots have all three, other tasks those that `list` shows. They are made by playing the behaviour
policies that come with this package, once, and kept in the cache. The same name and size give the
same bytes. They are not D4RL's. That data, Minari's and OG-MARL's can be imported, and so can
deployment logs, to train from what an earlier run did.
"""
EXAMPLES = """\
examples:
  python -m otc_dist.datasets list
  python -m otc_dist.datasets make hopper-3x1/medium-replay
  python -m otc_dist.datasets make hopper-3x1/medium --transitions 20000
  python -m otc_dist.datasets show hopper-3x1/medium
  python -m otc_dist.datasets import hopper_medium-v2.hdf5 --name d4rl-medium
  python -m otc_dist.launch 3agent_hopper --set dataset.name=hopper-3x1/d4rl-medium
  python -m otc_dist.datasets import runs/3agent_hopper-seed0/deployments/*.mcap --name deployed
  python -m otc_dist.launch 3agent_hopper --set dataset.name=hopper-3x1/deployed

The cache is {cache}; set OTC_DIST_CACHE to keep it elsewhere.
"""


def main(argv: list[str]) -> int:
    """Run one command. Raises UserError for what the user can fix."""
    arguments = command_line().parse_args(argv)
    if arguments.command == "list":
        _list()
    elif arguments.command == "make":
        user_code.allow(arguments.name.rpartition("/")[0])
        with progress.shown(f"making {arguments.name}", "transitions") as report:
            card = store.ensure(arguments.name, arguments.transitions, report, arguments.agent)
        say(*describe(card))
    elif arguments.command == "show":
        say(*describe(store.cached(arguments.name, arguments.transitions)))
    else:
        user_code.allow(arguments.env, *arguments.allow)
        with progress.shown("reading", "logs") as report:
            given = (arguments.files, arguments.name, arguments.env)
            card = import_files(*given, report, arguments.mapping)
        say(*describe(card))
    return 0


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.datasets",
        description=DESCRIPTION,
        epilog=EXAMPLES.format(cache=cache_root()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser("list", help="every known data set, and the sizes that are in the cache")
    make = commands.add_parser("make", help="make a data set, or check the one that is there")
    show = commands.add_parser("show", help="returns, sizes, versions and hashes of a data set")
    for command in (make, show):
        command.add_argument("name", metavar="NAME", help="for example hopper-3x1/medium-replay")
        command.add_argument(
            "--transitions",
            type=_size,
            default=0,
            metavar="N",
            help="size, if not the usual one, which `list` shows",
        )
    make.add_argument(
        "--agent",
        action="append",
        default=[],
        metavar="NAME",
        help="keep this agent's file only, on a machine where no other learns; may be repeated",
    )
    importing = commands.add_parser(
        "import",
        help="import deployment logs, or others' files: D4RL, Minari, OG-MARL, LeRobot, ROS 2",
        description="Import deployment logs of one environment, joined; a joint Minari data set, "
        "as `replay --export minari` makes it; a Flashbax vault of OG-MARL; a LeRobot data set; "
        "or a recording of single-agent play, whose action vector is split among the agents; or, "
        "by --mapping, a ROS 2 recording. Of unfinished or "
        "damaged logs what is intact is taken, and from others' recordings transitions without a "
        "known true successor s' are dropped; the data set's notes say so.",
    )
    importing.add_argument(
        "files",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="deployment logs (RUN/deployments/*.mcap); or one D4RL HDF5 file or Minari data set "
        "(its folder or its main_data.hdf5); or one vault or LeRobot data set (its folder); or "
        "one agent's own AGENT.safetensors from elsewhere",
    )
    importing.add_argument(
        "--name",
        default="",
        metavar="WORD",
        help="the data set is then ENVIRONMENT/WORD; default: the name of the logs' run",
    )
    importing.add_argument(
        "--env",
        default="",
        metavar="ENVIRONMENT",
        help="for example hopper-3x1, or module:function of your own, which is then run; default: "
        "what the logs say, or the team of the robot that FILE names",
    )
    importing.add_argument(
        "--mapping",
        type=Path,
        metavar="FILE",
        help="import FILE as a ROS 2 recording (rosbag2, MCAP): which field of which topic is what",
    )
    user_code.add_flag(importing)
    return parser


def _size(text: str) -> int:
    """The value of --transitions."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"ask for 1 or more, not {text}")
    return int(text)


def _list() -> None:
    rows = [("NAME", "USUAL SIZE", "IN THE CACHE", "MB")]
    for name in known_names():
        sizes = name.sizes()
        files = [f for size in sizes for f in name.set_folder(size).glob("*.safetensors")]
        rows.append(
            (
                str(name),
                f"{name.usual_size():,}",
                "  ".join(f"{size:,}" for size in sizes) or "-",
                f"{sum(file.stat().st_size for file in files) / 1e6:.1f}" if sizes else "-",
            )
        )
    say(*aligned(rows))


def describe(card: DatasetCard) -> list[str]:
    """The card as aligned text."""
    folder = DatasetName(card.env_id, card.name.partition("/")[2]).folder / str(card.transitions)
    ends = f"{card.terminated:,} terminated, {card.truncated:,} truncated"
    episodes = f"{card.episodes:,} complete, {card.incomplete_episodes:,} cut short"
    rows = [
        ("name", card.name),
        ("transitions", f"{card.transitions:,} ({ends})"),
        ("episodes", episodes),
        ("return", _summary(card.returns)),
        ("normalised score", _summary(card.normalised_score)),
        ("origin", card.origin),
        *(("", f"{key}: {value}") for key, value in card.recipe.items()),
        *(("note", note) for note in card.notes),
        ("versions", ", ".join(f"{key} {value}" for key, value in card.versions.items())),
        ("folder", str(folder)),
    ]
    for agent, file in card.files.items():
        sizes = f"observation {file.observation_size}, action {file.action_size}"
        rows.append((agent, f"{file.bytes / 1e6:.1f} MB, {sizes}"))
        rows.append(("", f"sha256 {file.sha256}"))
    return aligned(rows)


def _summary(summary: Summary | None) -> str:
    if summary is None:
        return "not known"
    low, high = f"{summary.minimum:.1f}", f"{summary.maximum:.1f}"
    return f"mean {summary.mean:.1f}, std {summary.std:.1f}, from {low} to {high}"


if __name__ == "__main__":
    run_main(main)
