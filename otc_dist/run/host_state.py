"""The little that the env host must remember besides the log, to go on after a crash."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field

from otc_dist.run.folder import RunFolder
from otc_dist.system import durable, records
from otc_dist.terminal.errors import UserError


@dataclass(frozen=True)
class HostState:
    """Kept in `deployments/host.json`.

    epoch: how often an env host of this run has been started, from 1; it goes with every message,
        so that nothing of an earlier host is taken for the present one's.
    deployment, policies: agent -> digest of the policy that acts in deployment k.
    """

    epoch: Annotated[int, Field(ge=0, lt=2**32)] = 0
    deployment: int = 0
    policies: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def begin(cls, folder: RunFolder) -> Self:
        """The state of a host that starts now: one epoch further.

        Raises:
            UserError: the file is damaged, or cannot be written.
        """
        path = _path(folder)
        try:
            before = records.read_json(cls, path)
        except FileNotFoundError:
            before = cls()
        except UserError as error:
            raise UserError(f"{error}; it must hold the last epoch") from None
        state = replace(before, epoch=before.epoch + 1)
        try:
            state._write(folder)
        except OSError as error:
            raise UserError(f"cannot write {path}: {error.strerror}") from None
        return state

    def deploying(self, k: int, policies: Mapping[str, str], folder: RunFolder) -> Self:
        """The state in deployment k, written. Raises OSError."""
        state = replace(self, deployment=k, policies=policies)
        state._write(folder)
        return state

    def _write(self, folder: RunFolder) -> None:
        durable.write(_path(folder), (json.dumps(asdict(self)) + "\n").encode())


def _path(folder: RunFolder) -> Path:
    return folder.root / "deployments" / "host.json"
