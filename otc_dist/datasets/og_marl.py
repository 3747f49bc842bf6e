"""Read OG-MARL's vaults as a team's data: one row a step, as its recorder and its systems have it.

    observations, actions, rewards, terminals, truncations?    by agent, see `fields`
    infos.legals?                                              masks of the available actions

An episode ends where all agents are terminal or truncated. What was seen after that is not stored,
so the last transition of an episode has no successor, and is dropped; within an episode s' is the
next row's. Our own exports have what is missing:

    infos.next_observations, infos.next_legals?    the true successors of every row
    infos.cut          the row is the last that was exported of an unfinished episode
    infos.log, infos.copy, infos.step              which step of which log and copy a row is
"""

from pathlib import Path

import numpy as np

from otc_dist.datasets.fields import Fields
from otc_dist.datasets.found import Found, begun_episodes, kept, left_out
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.vault import Vault
from otc_dist.datasets.writing import Provenance, versions
from otc_dist.envs import registry
from otc_dist.names import from_text
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32


def read(path: Path, env_id: str) -> Found:
    """Read a vault.

    Args:
        path: its folder, as `3m.vlt/Good`.
        env_id: whose observations and actions they are; "": as our own export names it.

    Raises:
        UserError: no vault, another version, damage, missing arrays, other agents or sizes than
            the environment's, or bad values.
    """
    vault = Vault(path)
    named = _environment(vault.about)
    if not (env_id or named):
        raise UserError(f"{vault.folder} does not say what it was recorded in: say it with --env")
    team = registry.team_spec(env_id or named)
    fields = Fields(vault, team)
    data, begun, known, notes = _rows(fields, team)
    left = kept(data, begun, known, team, str(vault.folder))
    others = sorted(from_text(name) for name in set(vault.names) - fields.taken)
    notes += left.notes + left_out("arrays", others)
    origin = f"recorded in {named}" if named else f"the vault names no environment: {team.env_id}"
    recipe = {"vault": "/".join(vault.folder.resolve().parts[-2:]), "sha256": vault.sha256()}
    made = Provenance(
        f"imported from the vault {recipe['vault']}",
        recipe,
        versions("tensorstore"),
        left.returns,
        left.incomplete,
        (origin, *notes),
    )
    return Found(team, left.data, made)


def _environment(about: object) -> str:
    """The environment that our own export names, or ""."""
    named = about.get("environment") if isinstance(about, dict) else None
    return named if isinstance(named, str) else ""


def _rows(fields: Fields, team: TeamSpec) -> tuple[JointTransitions, Bool, Bool, tuple[str, ...]]:
    """All rows; whether their episodes have their beginnings, whether s' is known; notes."""
    seen, notes = _observations(fields, team, "")
    terminals = np.stack(fields.flags("terminals"))
    truncations = np.zeros_like(terminals)
    if fields.has("truncations"):
        truncations = np.stack(fields.flags("truncations"))
    else:
        notes += ("no truncations in the vault: no episode was taken to be cut",)
    ends = np.asarray((terminals | truncations).all(axis=0))
    if early := int((terminals.any(axis=0) & ~ends).sum()):
        notes += (f"in {early} steps some agents had ended, and the team had not",)
    terminated = np.asarray(terminals.all(axis=0))
    truncated = ends & ~terminated
    last = ends.copy()
    last[fields.rows - 1 :: fields.rows] = True  # of a stream
    if fields.has("infos.next_observations"):
        successors, _ = _observations(fields, team, "next_")
        known = np.ones_like(ends)
        cut = fields.shared("infos.cut")
        truncated = np.asarray(truncations.all(axis=0))  # both: the simulator broke off
        if cut is not None:
            truncated &= cut == 0
    else:
        successors = tuple(np.roll(array, -1, axis=0) for array in seen)
        known = ~last
    data = JointTransitions(
        observations=seen,
        actions=fields.vectors("actions", [a.action_size for a in team.agents], filled=False),
        rewards=fields.numbers("rewards"),
        next_observations=successors,
        terminated=terminated,
        truncated=truncated,
        episodes=np.concatenate(([0], np.cumsum(last[:-1]))),
    )
    return data, _begun(fields, data), known, notes


def _observations(
    fields: Fields, team: TeamSpec, which: str
) -> tuple[tuple[Float32, ...], tuple[str, ...]]:
    """N x (T, observation_size), with the masks of discrete actions after them; notes.

    Args:
        which: "" for what an agent saw before the step, "next_" for what it saw after it.
    """
    name, legals = (
        (f"infos.{which}observations" if which else "observations"),
        f"infos.{which}legals",
    )
    choices = [agent.choices for agent in team.agents]
    whole = [agent.observation_size for agent in team.agents]
    own = [size - count for size, count in zip(whole, choices, strict=True)]
    seen = fields.vectors(name, own, whole)
    if [array.shape[1] for array in seen] == whole:
        return seen, ()
    notes: tuple[str, ...] = ()
    if fields.has(legals):
        masks = fields.vectors(legals, choices)
        for agent, mask in zip(team.names, masks, strict=True):
            if not np.isin(mask, (0, 1)).all():
                raise UserError(f"{fields.source}: {legals} of {agent} are not 0 and 1")
    else:
        masks = tuple(np.ones((len(seen[0]), count), np.float32) for count in choices)
        notes = (f"no {legals} in the vault: every action was taken to be available",)
    joined = zip(seen, masks, strict=True)
    return tuple(np.concatenate(parts, axis=1) for parts in joined), notes


def _begun(fields: Fields, data: JointTransitions) -> Bool:
    """Whether each row's episode is there from its first step (T,)."""
    starts = np.flatnonzero(np.diff(data.episodes, prepend=-1))
    places = [fields.shared(f"infos.{name}") for name in ("log", "copy", "step")]
    found = [place[starts] for place in places if place is not None and place.dtype.kind in "iu"]
    return begun_episodes(data, found if len(found) == len(places) else None)
