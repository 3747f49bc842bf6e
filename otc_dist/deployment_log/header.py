"""What a deployment log says about itself: where the steps come from and how to read them."""

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Json, ValidationError

import otc_dist
from otc_dist.deployment_log.format import (
    FIRST_BOUND_VERSION,
    FIRST_TIMED_VERSION,
    FORMAT_VERSION,
    MINIMUM_FORMAT_VERSION,
    UNTIMED_VERSION,
)
from otc_dist.deployment_log.record import RecordLayout
from otc_dist.names import Name
from otc_dist.spec import TeamSpec, check_team
from otc_dist.system.records import why
from otc_dist.system.versions import PACKAGES, of_packages
from otc_dist.terminal.errors import UserError


def versions() -> dict[str, str]:
    """Versions of otc_dist, Python, the machine's architecture and the packages that matter."""
    return {
        "otc_dist": otc_dist.__version__,
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        **of_packages(*PACKAGES),
    }


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
    format_version: int = UNTIMED_VERSION

    @property
    def bound(self) -> bool:
        """Whether the checksums of its steps and tables hold in this log alone."""
        return self.format_version >= FIRST_BOUND_VERSION

    @property
    def timed(self) -> bool:
        """Whether its steps were taken by a clock, and say which deadlines were missed."""
        return self.format_version >= FIRST_TIMED_VERSION

    @property
    def binding(self) -> int:
        """What those checksums begin with: a digest of run, deployment, seed and description.

        0 in the older form, whose checksums hold in any log.
        """
        if not self.bound:
            return 0
        parts = (self.run, str(self.deployment), str(self.seed), self.description)
        text = "\0".join((*parts, self.description_digest))
        return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=4).digest())

    def layout(self) -> RecordLayout:
        """The record of a step. Raises UserError if it is larger than a record may be."""
        return RecordLayout(self.team, self.copies, self.binding, self.timed)

    def to_entries(self) -> dict[str, str]:
        """The header as strings; numbers and structures in JSON."""
        bound = {"binding": str(self.binding)} if self.bound else {}
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
            **bound,
        }

    @classmethod
    def from_entries(cls, entries: Mapping[str, str], path: Path) -> "LogHeader":
        """Inverse of `to_entries`; `path` is for the message.

        Raises:
            UserError: the log is of a version that this code does not read, a field is missing or
                is not what it must be, or a step is larger than a record may be.
        """
        try:
            format_version = int(entries.get("format_version", ""))
        except ValueError:
            raise UserError(f"{path}: its header has no format_version") from None
        if not MINIMUM_FORMAT_VERSION <= format_version <= FORMAT_VERSION:
            newer = format_version > FORMAT_VERSION
            raise UserError(
                f"{path} is of log version {format_version}, "
                f"{'newer' if newer else 'older'} than what this otc_dist "
                f"({otc_dist.__version__}) reads: "
                f"{'at most' if newer else 'at least'} version "
                f"{FORMAT_VERSION if newer else MINIMUM_FORMAT_VERSION}"
            )
        try:
            fields = _Entries.model_validate(entries)
        except ValidationError as error:
            raise UserError(f"{path}: its header is not valid: {why(error)}") from None
        header = cls(**{name: getattr(fields, name) for name in _Entries.model_fields})
        try:
            header.layout()
        except UserError as error:
            raise UserError(f"{path}: its header is not valid: {error}") from None
        return header


class _Entries(BaseModel):
    """A header's entries, all strings; a checksum vouches for their bytes, and for no more."""

    model_config = ConfigDict(frozen=True)

    format_version: int
    run: Name
    deployment: int = Field(ge=1, lt=2**31)
    seed: int = Field(ge=0, lt=2**63)
    description: str
    description_digest: str = Field(pattern=r"^[0-9a-f]{0,64}$")
    team: Json[Annotated[TeamSpec, AfterValidator(check_team)]]
    copies: int = Field(ge=1, lt=2**31)
    versions: Json[dict[str, str]]
