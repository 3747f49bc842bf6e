"""`--resume RUN --deployments N`: a run that is finished goes on, to more deployments."""

from dataclasses import replace

from otc_dist.deployment_log.measuring import read_measured
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.run import recommendation
from otc_dist.run.folder import RunFolder
from otc_dist.system import durable
from otc_dist.terminal.errors import UserError

from ..plan import run_record
from ..plan.run_record import RunRecord


def extend(folder: RunFolder, deployments: int) -> None:
    """Let a run have so many deployments; `run_record.reopen` then goes on with it.

    Deployments and policies do not depend on how many are to come (`Description.tuning_digest`), so
    those made already stay as they are. Where this was killed, it is done by being asked again.

    Raises:
        UserError: the run is one of several hosts; its description has changed; it cannot go on;
            or as many deployments are made already.
    """
    record, description = RunRecord.read(folder), Description.load(folder.description).trusted()
    if record.place.role != "all":
        raise UserError(
            "--deployments extends a run whose processes are all on one machine; on several, begin"
            " another run that takes its policies (--from)"
        )
    longer = description.with_assignments(f"deployment.count={deployments}")
    if record.description not in (description.digest(), longer.digest()):
        raise run_record.changed(folder)
    run_record.check_versions(record, folder)
    _check(folder, description, deployments)
    made = replace(
        record,
        description=longer.digest(),
        state="stopped",
        finished=None,
        extended=(*record.extended, deployments),
    )
    made.write(folder)
    durable.write(folder.description, longer.to_toml().encode())


def _check(folder: RunFolder, description: Description, deployments: int) -> None:
    settings = description.deployment
    if registry.changes(description.env.id):
        raise UserError(
            f"{folder.root} cannot be extended: {description.env.id} changes in the course of the"
            " deployments, by how many there are"
        )
    if description.sampling.bound:
        raise UserError(
            f"{folder.root} cannot be extended: sampling.name = {description.sampling.name!r} keeps"
            " priorities for as many transitions as it began with"
        )
    logs = [k for k in range(1, settings.count + 1) if folder.deployment(k).exists()]
    if deployments <= len(logs):
        raise UserError(
            f"{folder.root} has made {len(logs)} deployments already: --deployments must be more"
        )
    if settings.floor is not None and logs:
        _, found = read_measured(folder.deployment(logs[-1]))
        if recommendation.ends(settings.floor, found):
            raise UserError(
                f"{folder.root} cannot be extended: deployment {logs[-1]} measured"
                f" {found.mean:,.1f}, below deployment.floor = {settings.floor:g}"
            )
