"""What a run ends with, as bytes: all that must not depend on what happened on the way."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from otc_dist.deployment_log.reader import read_steps
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.run_folder import RunFolder
from otc_dist.transitions import JointStep


def outcome(folder: RunFolder) -> dict[str, bytes]:
    """Digests of every checkpoint, every deployment's steps and every evaluation.

    Raises:
        OSError, UserError: something is missing or damaged.
    """
    description = Description.load(folder.description)
    found = {}
    for k in range(description.deployment.count + 1):
        for agent in registry.team_spec(description.env.id).names:
            path = folder.checkpoint(agent, k)
            found[f"checkpoint {k} of {agent}"] = hashlib.sha256(path.read_bytes()).digest()
        evaluation = json.loads(folder.evaluation(k).read_text(encoding="utf-8"))
        found[f"evaluation {k}"] = json.dumps(evaluation, sort_keys=True).encode()
        if k:
            found[f"deployment {k}"] = _steps(folder, k)
    return found


def differences(ours: Mapping[str, bytes], theirs: Mapping[str, bytes]) -> list[str]:
    """What differs."""
    return sorted(
        name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name)
    )


def _steps(folder: RunFolder, k: int) -> bytes:
    """A digest of deployment k: how many steps, and every bit of each."""
    digest, count = hashlib.sha256(), 0
    for step in read_steps(folder.deployment(k)):
        count += 1
        for field in fields(JointStep):
            value = getattr(step, field.name)
            for part in value if isinstance(value, tuple) else (value,):
                digest.update(np.asarray(part).tobytes())
    return count.to_bytes(8, "big") + digest.digest()
