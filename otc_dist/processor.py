"""Which processor computes: results of two kinds of it differ in bits, and so in returns."""

import platform
from pathlib import Path

# What decides which kernels torch and its libraries take.
_TELLING = ("avx2", "fma", "avx512f", "avx512_bf16", "avx512_vnni", "amx_bf16", "asimd", "sve")
_CPUINFO = Path("/proc/cpuinfo")


def processor(cpuinfo: Path = _CPUINFO) -> str:
    """The processor's name, and which of the telling instruction sets it has, as
    `AMD EPYC 7763 (avx2 fma)`; where the system does not say, what Python knows of it.
    """
    try:
        lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    found: dict[str, str] = {}
    for line in lines:
        key, _, value = line.partition(":")
        found.setdefault(key.strip().lower(), value.strip())
    name = found.get("model name") or platform.processor() or platform.machine()
    has = set(found.get("flags", found.get("features", "")).split())
    flags = " ".join(flag for flag in _TELLING if flag in has)
    return f"{name} ({flags})" if flags else name
