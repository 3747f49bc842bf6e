"""`--on kubernetes --print`: the manifests of one run, for `kubectl apply -f -`; none is applied.

Each process is a Job of its own with its own volume and its own certificate, so that a learner's
pod holds no other agent's data or key. A Job's pod has a name by which the others reach it, from
the run's headless Service; one that fails is started again on the same volume, and continues.
"""

import argparse
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from otc_dist import __version__
from otc_dist.bus.keys import HOST
from otc_dist.datasets.names import DatasetName
from otc_dist.description import Description
from otc_dist.names import is_code
from otc_dist.spec import TeamSpec
from otc_dist.system import extras
from otc_dist.terminal.errors import UserError

from ..plan import descriptions
from . import hosts

IMAGE = f"otc-dist:{__version__}"
PORT = 7447
_HOME = "/data"  # of a process: its part of the run, and its cache
_CERTIFICATES = "/certs"
_DESCRIPTION, _FILE = "/description", "description.toml"
_LONGEST = 63  # characters of a pod's name: RFC 1123, by which DNS knows it
_RESTARTS = 20  # of one pod

Manifest = dict[str, Any]  # as the API has it; tests validate it against its published schemas


def text(arguments: argparse.Namespace, chosen: Description, team: TeamSpec) -> str:
    """All manifests as YAML, and before them, as comments, what makes the certificates' secrets.

    Raises:
        UserError: names that Kubernetes does not take, what a pod has not, or PyYAML is not
            installed.
    """
    try:
        import yaml
    except ImportError:
        raise UserError(f"--on kubernetes needs PyYAML: {extras.install('kubernetes')}") from None
    _check(chosen, arguments.image)
    run = _name("otc", f"{chosen.name}-seed{chosen.seed}")  # a Service's begins with a letter
    pods = {process: _name(run, process) for process in (HOST, *team.names)}
    for process, pod in pods.items():
        if len(f"{pod}-0") > _LONGEST or list(pods.values()).count(pod) > 1:
            raise UserError(f"{process}'s pod cannot be called {pod}-0: use shorter or other names")
    address = f"{pods[HOST]}-0.{run}"
    learners = dict.fromkeys(team.names, address)
    found = hosts.Hosts(env_host=address, learners=learners, port=PORT, certs=_CERTIFICATES)
    words, made = hosts.run_words(arguments), [_service(run)]
    file = descriptions.find(arguments.description)
    own = file not in descriptions.shipped().values()  # the image has those that are
    if own:
        made.append(_description(run, file.read_text(encoding="utf-8")))
        words[0] = f"{_DESCRIPTION}/{_FILE}"
    for part in hosts.parts(found, words, arguments.insecure, bool(chosen.bus.router)):
        pod = pods[part.name]
        claim: Manifest = {"persistentVolumeClaim": {"claimName": pod}}
        mounted = [("data", claim, _HOME)]
        if own:
            mounted.append(("description", {"configMap": {"name": run}}, _DESCRIPTION))
        if not arguments.insecure:
            secret = {"secretName": pod, "defaultMode": 0o400}
            mounted.append(("certs", {"secret": secret}, f"{_CERTIFICATES}/{part.name}"))
        container = _container(part.command, arguments.image, chosen.engine.name == "cuda-graph")
        made += [_volume(run, pod), _job(run, pod, container, mounted)]
    lines = [] if arguments.insecure else list(_secrets(pods, address))
    documents: str = yaml.safe_dump_all(made, sort_keys=False, width=100)
    return "\n".join([*lines, documents.rstrip("\n")])


def _check(chosen: Description, image: str) -> None:
    """Raises UserError for what a pod would miss."""
    if image == IMAGE and (code := [*filter(is_code, chosen.code)]):
        raise UserError(
            f"{code[0]} is code of your own, and the image {image} has ours alone: build one from"
            " it that has yours, and name it with --image"
        )
    if not DatasetName.parse(chosen.dataset.name).source:
        raise UserError(
            f"the data set {chosen.dataset.name} was imported here, and pods only have what they"
            " make: use another, or --hosts"
        )


def _name(*parts: str) -> str:
    """As Kubernetes takes names: small letters, digits and hyphens."""
    found = "-".join(parts).lower()
    return re.sub(r"[^a-z0-9-]", "-", found).strip("-")


def _secrets(pods: Mapping[str, str], address: str) -> Iterator[str]:
    yield "# Once, where the certificates are made; each secret holds one process's:"
    yield f"#   python -m otc_dist.certs certs --agents {len(pods) - 1} --host {address}"
    for process, pod in pods.items():
        yield f"#   kubectl create secret generic {pod} --from-file=certs/{process}"


def _labels(run: str) -> dict[str, str]:
    return {"app.kubernetes.io/name": "otc-dist", "app.kubernetes.io/instance": run}


def _service(run: str) -> Manifest:
    """By which pods find each other's addresses; headless, since nothing is to be balanced."""
    return {
        "apiVersion": "v1",
        "kind": "Service",
        "metadata": {"name": run, "labels": _labels(run)},
        "spec": {
            "clusterIP": "None",
            "selector": _labels(run),
            "publishNotReadyAddresses": True,
            "ports": [{"name": "zenoh", "port": PORT}],
        },
    }


def _volume(run: str, pod: str) -> Manifest:
    return {
        "apiVersion": "v1",
        "kind": "PersistentVolumeClaim",
        "metadata": {"name": pod, "labels": _labels(run)},
        "spec": {
            "accessModes": ["ReadWriteOnce"],
            "resources": {"requests": {"storage": "4Gi"}},
        },
    }


def _description(run: str, text: str) -> Manifest:
    return {
        "apiVersion": "v1",
        "kind": "ConfigMap",
        "metadata": {"name": run, "labels": _labels(run)},
        "data": {_FILE: text},
    }


def _container(command: str, image: str, gpu: bool) -> Manifest:
    limits = {"memory": "4Gi"} | ({"nvidia.com/gpu": "1"} if gpu else {})
    return {
        "name": "otc-dist",
        "image": image,
        # Kubernetes replaces $(NAME), and takes $$ for one $.
        "command": ["sh", "-c", f"exec {command}".replace("$", "$$")],
        "workingDir": _HOME,
        "env": [{"name": "OTC_DIST_CACHE", "value": f"{_HOME}/cache"}],
        "resources": {"requests": {"cpu": "1", "memory": "1Gi"}, "limits": limits},
    }


def _job(
    run: str,
    pod: str,
    container: Manifest,
    mounted: Sequence[tuple[str, Manifest, str]],  # name, what, and where
) -> Manifest:
    mounts = [{"name": name, "mountPath": path} for name, _, path in mounted]
    template = {
        "metadata": {"labels": _labels(run)},
        "spec": {
            "subdomain": run,
            "restartPolicy": "OnFailure",
            "containers": [container | {"volumeMounts": mounts}],
            "volumes": [{"name": name, **what} for name, what, _ in mounted],
        },
    }
    # Indexed, for the one name that its pod has whatever becomes of it: NAME-0.
    runs = {"completions": 1, "completionMode": "Indexed", "backoffLimit": _RESTARTS}
    return {
        "apiVersion": "batch/v1",
        "kind": "Job",
        "metadata": {"name": pod, "labels": _labels(run)},
        "spec": {**runs, "template": template},
    }
