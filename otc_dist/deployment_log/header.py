"""What a deployment log says about itself: where the steps come from and how to read them."""

import json
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import otc_dist
from otc_dist.deployment_log.format import FORMAT_VERSION, MINIMUM_FORMAT_VERSION
from otc_dist.errors import UserError
from otc_dist.spec import AgentSpec, TeamSpec

_RECORDED_PACKAGES = ("mujoco", "numpy", "mcap", "msgpack", "torch", "eclipse-zenoh")


def versions() -> dict[str, str]:
    """Versions of otc_dist, Python, the machine's architecture and the packages that matter."""
    found = {
        "otc_dist": otc_dist.__version__,
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }
    for package in _RECORDED_PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


@dataclass(frozen=True)
class LogHeader:
    """The header of one deployment's log.

    Written as an MCAP metadata record of strings, once more in the channel's metadata.
    """

    run: str
    deployment: int  # k = 1..K
    seed: int
    description: str  # the resolved launch description, TOML
    description_digest: str
    team: TeamSpec
    copies: int  # E
    versions: Mapping[str, str] = field(default_factory=versions)
    format_version: int = FORMAT_VERSION

    def to_entries(self) -> dict[str, str]:
        """The header as strings; numbers and structures in JSON."""
        return {
            "format_version": str(self.format_version),
            "run": self.run,
            "deployment": str(self.deployment),
            "seed": str(self.seed),
            "copies": str(self.copies),
            "team": json.dumps(asdict(self.team)),
            "versions": json.dumps(dict(self.versions)),
            "description": self.description,
            "description_digest": self.description_digest,
        }

    @classmethod
    def from_entries(cls, entries: Mapping[str, str], path: Path) -> "LogHeader":
        """Inverse of `to_entries`; `path` is for the message.

        Raises:
            UserError: the log is of a version that this code does not read.
        """
        format_version = int(entries["format_version"])
        if not MINIMUM_FORMAT_VERSION <= format_version <= FORMAT_VERSION:
            newer = format_version > FORMAT_VERSION
            raise UserError(
                f"{path} is of log version {format_version}, "
                f"{'newer' if newer else 'older'} than what this otc_dist "
                f"({otc_dist.__version__}) reads: "
                f"{'at most' if newer else 'at least'} version "
                f"{FORMAT_VERSION if newer else MINIMUM_FORMAT_VERSION}"
            )
        return cls(
            run=entries["run"],
            deployment=int(entries["deployment"]),
            seed=int(entries["seed"]),
            description=entries["description"],
            description_digest=entries["description_digest"],
            team=_team(json.loads(entries["team"])),
            copies=int(entries["copies"]),
            versions=json.loads(entries["versions"]),
            format_version=format_version,
        )


def _team(data: dict[str, object]) -> TeamSpec:
    agents = data.pop("agents")
    if not isinstance(agents, list):
        raise TypeError(f"agents is a list, not {type(agents).__name__}")
    return TeamSpec(
        agents=tuple(
            AgentSpec(
                name=agent["name"],
                observation_size=agent["observation_size"],
                action_low=tuple(agent["action_low"]),
                action_high=tuple(agent["action_high"]),
                choices=agent.get("choices", 0),
            )
            for agent in agents
        ),
        **data,  # type: ignore[arg-type]  # the checksum has vouched for what we wrote
    )
