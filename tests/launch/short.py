"""A description whose data are few, which nothing here trains on."""

from otc_dist.description import Description
from otc_dist.launch.plan import descriptions

SHORT = ("--set", "dataset.transitions=100", "--set", "engine.name=eager")


def short_description() -> Description:
    return descriptions.load("3agent_hopper", SHORT[1::2], None, quick=False)
