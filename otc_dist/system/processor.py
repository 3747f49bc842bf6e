"""Which processor computes, and by which libraries: results of two kinds of it differ in bits, and
so in returns.
"""

import os
import platform
import re
from pathlib import Path

# What decides which kernels torch and its libraries take.
_TELLING = ("avx2", "fma", "avx512f", "avx512_bf16", "avx512_vnni", "amx_bf16", "asimd", "sve")
_CPUINFO = Path("/proc/cpuinfo")
# By which a user, or a cluster, has libraries take other kernels than the processor's best.
_SETTINGS = (
    *("ATEN_CPU_CAPABILITY", "MKL_CBWR", "MKL_DEBUG_CPU_TYPE", "MKL_ENABLE_INSTRUCTIONS"),
    *("ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA", "OPENBLAS_CORETYPE", "BLIS_ARCH_TYPE"),
    *("NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES", "GLIBC_TUNABLES"),
)
_MATHEMATICS = re.compile(
    r"lib(m|mkl\w*|\w*openblas\w*|c?blas|lapacke?|blis|flexiblas|dnnl|torch_cpu|[gi]?omp5?|mujoco)"
    r"[-.]"
)


def processor(cpuinfo: Path = _CPUINFO) -> str:
    """The processor's name, and which of the relevant instruction sets it has, as
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


def kind() -> str:
    """The processor, and the settings by which libraries leave instructions of it unused, as
    `AMD EPYC 7763 (avx2 fma) MKL_CBWR=AVX`.
    """
    settings = [f"{key}={os.environ[key]}" for key in _SETTINGS if os.environ.get(key)]
    return " ".join([processor(), *settings])


def libraries(pid: int) -> tuple[str, ...]:
    """Paths of the libraries that compute in a process of this user's; none where unknown."""
    try:
        maps = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ()
    paths = {line.split(maxsplit=5)[5] for line in maps.splitlines() if "/" in line}
    return tuple(sorted(path for path in paths if _MATHEMATICS.match(path.rpartition("/")[2])))
