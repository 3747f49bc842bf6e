"""`--on kubernetes --print`: manifests that the published schemas take, and what a pod can see."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from otc_dist.certs import authority
from otc_dist.launch.run.command import main
from otc_dist.terminal.errors import UserError

AGENTS = ("agent_0", "agent_1", "agent_2")
PRINT = ("--on", "kubernetes", "--print")
RUN = "otc-3agent-hopper-seed0"
# Of what a Service is called (RFC 1035); whatever else is here may be called so as well.
NAME = re.compile("[a-z]([-a-z0-9]{0,61}[a-z0-9])?")
Printed = Callable[..., tuple[str, dict[tuple[str, str], Any]]]


@pytest.fixture
def printed(capsys: pytest.CaptureFixture[str]) -> Printed:
    """The text, and its manifests by kind and name, each valid."""

    def show(*flags: str) -> tuple[str, dict[tuple[str, str], Any]]:
        assert main([*flags, *PRINT]) == 0
        text = capsys.readouterr().out
        made = list(yaml.safe_load_all(text))
        for manifest in made:
            kubernetes_validate.validate(manifest, "1.30", strict=True)
            assert NAME.fullmatch(manifest["metadata"]["name"])
        return text, {(m["kind"], m["metadata"]["name"]): m for m in made}

    return show


def test_every_process_is_a_job_that_sees_its_own(printed: Printed, tmp_path: Path) -> None:
    list(authority.make(tmp_path / "certs", AGENTS, ["localhost"], days=1))
    text, made = printed("3agent_hopper", "--seed", "0", "--set", "deployment.count=2")
    pods = [f"{RUN}-{part}" for part in ("host", "agent-0", "agent-1", "agent-2")]
    kinds = [("Job", pod) for pod in pods] + [("PersistentVolumeClaim", pod) for pod in pods]
    assert set(made) == {("Service", RUN), *kinds}
    assert "PRIVATE KEY" not in text
    for pod, process in zip(pods, ("host", *AGENTS), strict=True):
        spec = made["Job", pod]["spec"]["template"]["spec"]
        (container,) = spec["containers"]
        volumes = {volume["name"]: volume for volume in spec["volumes"]}
        assert volumes["certs"]["secret"]["secretName"] == pod
        assert volumes["data"]["persistentVolumeClaim"]["claimName"] == pod
        assert {mount["mountPath"] for mount in container["volumeMounts"]} == {
            "/data",
            f"/certs/{process}",
        }
        command = container["command"][-1]
        role = "--role host --listen tls/0.0.0.0:7447"
        if process != "host":
            role = f"--role learner --agent {process} --connect tls/{RUN}-host-0.{RUN}:7447"
        assert f"3agent_hopper --set deployment.count=2 --seed 0 {role} --certs /certs" in command
        secret = f"#   kubectl create secret generic {pod} --from-file=certs/{process}"
        assert secret in text.splitlines()
        files = {path.name for path in (tmp_path / "certs" / process).iterdir()}
        assert files == {"authority.pem", "certificate.pem", "key.pem"}


def test_a_description_of_ones_own_goes_along(printed: Printed, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\n[env]\nid = "hopper-3x1"\n[dataset]\nname = "random"\n')
    _, made = printed(str(file), "--insecure")
    assert made["ConfigMap", "otc-mine-seed0"]["data"]["description.toml"] == file.read_text()
    spec = made["Job", "otc-mine-seed0-agent-1"]["spec"]["template"]["spec"]
    assert "/description/description.toml" in spec["containers"][0]["command"][-1]
    assert [volume["name"] for volume in spec["volumes"]] == ["data", "description"]


def test_what_a_pod_is_given_is_what_was_asked_for(
    printed: Printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[1])  # toys
    own = ("--set", "algorithm.name=toys:Cloning", "--image", "mine:1")
    asked = ("--set", "engine.name=cuda-graph", "--set", "summary=5 $(HOME)")
    _, made = printed("3agent_hopper", "--insecure", *asked, *own)
    (container,) = made["Job", f"{RUN}-host"]["spec"]["template"]["spec"]["containers"]
    assert container["image"] == "mine:1"
    assert container["resources"]["limits"]["nvidia.com/gpu"] == "1"
    assert "'summary=5 $$(HOME)'" in container["command"][-1]


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--on", "kubernetes"), "nothing is applied from here: add --print"),
        (("--print",), "--print needs --on kubernetes"),
        (("--on", "slurm", "--print"), "--print and --image are for --on kubernetes"),
        ((*PRINT, "--role", "host"), "leave out --role"),
        ((*PRINT, "--set", f"name={'long' * 12}"), "pod cannot be called"),
        ((*PRINT, "--set", "algorithm.name=toys:Cloning"), "toys:Cloning is code of your own, and"),
        ((*PRINT, "--set", "dataset.name=hopper-3x1/mine"), "mine was imported here, and pods"),
    ],
)
def test_what_cannot_be_is_one_line(
    flags: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[1])  # toys
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path))
    (tmp_path / "datasets" / "hopper-3x1" / "mine" / "100").mkdir(parents=True)
    with pytest.raises(UserError, match=says):
        main(["3agent_hopper", *flags])
