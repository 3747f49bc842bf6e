"""Other people's JavaScript, to read our logs with."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

_PACKAGES = (
    "@mcap/core@2.2.2",
    "fzstd@0.1.1",
    "@msgpack/msgpack@3.1.2",
    "@mcap/support@1.1.0",
    "ajv@8.20.0",
)

# What a script begins with that opens logs: `await opened(name)` is the file, and its reader.
OPENED = """
import { McapIndexedReader } from "@mcap/core";
import { decompress } from "fzstd";
import { open } from "node:fs/promises";

async function opened(name) {
  const file = await open(name);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, length) => {
      const bytes = new Uint8Array(Number(length));
      await file.read(bytes, 0, Number(length), Number(offset));
      return bytes;
    },
  };
  const zstd = (data, size) => decompress(data, new Uint8Array(Number(size)));
  return [file, await McapIndexedReader.Initialize({ readable, decompressHandlers: { zstd } })];
}
"""


def run_script(script: str, *arguments: object) -> str:
    """What a module printed; skips the test where Node, npm or the packages cannot be had."""
    folder = _folder()
    path = folder / f"script_{os.getpid()}.mjs"
    path.write_text(script)
    try:
        out = subprocess.run(
            ["node", str(path), *map(str, arguments)],
            capture_output=True,
            text=True,
            check=False,
        )
    finally:
        path.unlink()
    assert out.returncode == 0, out.stderr
    return out.stdout


def _folder() -> Path:
    """A folder with the packages, kept between test sessions."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("node and npm are not installed")
    base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = base / "otc_dist_tests" / "npm-4"
    if not (folder / "ready").exists():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "package.json").write_text('{"private": true, "type": "module"}')
        installed = subprocess.run(
            ["npm", "install", "--no-audit", "--no-fund", *_PACKAGES],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if installed.returncode:
            pytest.skip(f"npm cannot install what reads logs: {installed.stderr[-200:]}")
        (folder / "ready").touch()
    return folder
