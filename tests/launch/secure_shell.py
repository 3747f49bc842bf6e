"""Hosts that are reached by ssh: a real sshd on addresses of this machine, and a real ssh to it."""

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator, Mapping, Set
from contextlib import contextmanager
from pathlib import Path

import pytest

SSHD = shutil.which("sshd") or "/usr/sbin/sshd"
SERVER = """\
Port {port}
{listen}
HostKey {folder}/server
AuthorizedKeysFile {folder}/user.pub
PidFile none
StrictModes no
PermitRootLogin prohibit-password
SetEnv {environment}
"""
CLIENT = """\
Host *
Port {port}
IdentityFile {folder}/user
IdentitiesOnly yes
StrictHostKeyChecking accept-new
UserKnownHostsFile {folder}/known
LogLevel ERROR
"""


@contextmanager
def hosts_by_ssh(
    folder: Path, addresses: Set[str], environment: Mapping[str, str]
) -> Iterator[Path]:
    """Let `ssh ADDRESS` in, without a password; yields the folder of an `ssh` that knows how.

    `environment` is what commands get there, beside the tests' cache.

    Skips the test where OpenSSH is missing, or may not serve.
    """
    ssh = shutil.which("ssh")
    if ssh is None or not os.access(SSHD, os.X_OK):
        pytest.skip("OpenSSH's ssh and sshd are not both installed (Debian: openssh-server)")
    if os.geteuid() == 0:  # what sshd gives up its rights in; a service's start makes it
        Path("/run/sshd").mkdir(mode=0o755, exist_ok=True)
    folder.mkdir()
    for name in ("server", "user"):
        key = ("-q", "-t", "ed25519", "-N", "", "-f", str(folder / name))
        subprocess.run(["ssh-keygen", *key], check=True)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    listen = "\n".join(f"ListenAddress {address}" for address in addresses)
    names = {"port": port, "folder": folder, "listen": listen}
    told = {"OTC_DIST_CACHE": os.environ["OTC_DIST_CACHE"], **environment}
    names["environment"] = " ".join(f'"{name}={value}"' for name, value in told.items())
    (folder / "sshd_config").write_text(SERVER.format(**names))
    (folder / "ssh_config").write_text(CLIENT.format(**names))
    tool = folder / "bin" / "ssh"
    tool.parent.mkdir()
    tool.write_text(f'#!/bin/sh\nexec {ssh} -F {folder}/ssh_config "$@"\n')
    tool.chmod(0o755)
    server = subprocess.Popen(
        [SSHD, "-D", "-e", "-f", str(folder / "sshd_config")], stderr=subprocess.PIPE, text=True
    )
    try:
        assert server.stderr is not None
        said = [server.stderr.readline() for _ in addresses]
        if not all("listening" in line for line in said):
            pytest.skip(f"sshd does not serve here: {' '.join(said).strip()}")
        yield tool.parent
    finally:
        server.terminate()
        server.communicate()
