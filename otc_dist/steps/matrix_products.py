"""Matrix products by the widest vectors that the processor has, in code that torch compiles.

torch's compiler calls MKL for float32 products, which leaves half of the vector width of AMD's
processors unused, and is slow where matrices are small or a product has few columns. torch brings
oneDNN's kernel too, which has neither fault but no operation of its own: product.cpp makes it one.
Results differ by rounding.
"""

import ctypes
import functools
import hashlib
import logging
import os
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from torch import Tensor
from torch._inductor import config
from torch._inductor.config import aot_inductor
from torch._inductor.cpu_vec_isa import pick_vec_isa, valid_vec_isa_list
from torch._inductor.custom_graph_pass import CustomGraphPass, get_hash_for_files
from torch.fx import Graph

from otc_dist.system.cache import compiled_root

SOURCE = Path(__file__).with_name("product.cpp")
TORCH = Path(torch.__file__).parent
C_FUNCTION = (
    "AOTITorchError aoti_torch_cpu_own_product("
    "AtenTensorHandle, AtenTensorHandle, AtenTensorHandle*)"
)
aten = torch.ops.aten
log = logging.getLogger(__name__)


@torch.library.custom_op("otc_dist::own_product", mutates_args=())
def product(left: Tensor, right: Tensor) -> Tensor:
    """(..., m, k) times (..., k, n)."""
    return left @ right  # for those who run a graph; compiled code calls the C function


@product.register_fake
def _(left: Tensor, right: Tensor) -> Tensor:
    return left.new_empty((*left.shape[:-1], right.shape[-1]))


class Products(CustomGraphPass):
    """A pass of torch's compiler over one graph: float32 products are computed by `product`."""

    def uuid(self) -> bytes:
        """Compiled code is kept for as long as these files are the same."""
        return get_hash_for_files((__file__, str(SOURCE)))

    def __call__(self, graph: Graph) -> None:
        for operation in (aten.mm.default, aten.bmm.default):
            for node in graph.find_nodes(op="call_function", target=operation):
                if node.meta["val"].dtype == torch.float32:
                    node.target = torch.ops.otc_dist.own_product.default


def passes(compiler: str) -> list[CustomGraphPass]:
    """What makes `torch.compile` use the kernel; nothing where it is not to be had.

    Args:
        compiler: a C++ compiler's path.
    """
    if loaded(compiler) is None:
        return []
    aot_inductor.custom_ops_to_c_shims = _Shims()
    return [Products()]


class _Shims(dict[Any, list[str]]):
    """The C function of `product`, as torch's compiler asks for it.

    Its cache pickles all settings, and an operation cannot be pickled: this class can.
    """

    def __init__(self) -> None:
        super().__init__({torch.ops.otc_dist.own_product.default: [C_FUNCTION]})

    def __reduce__(self) -> tuple[type["_Shims"], tuple[()]]:
        return type(self), ()


@functools.cache
def loaded(compiler: str) -> Path | None:
    """The library whose kernel compiled code can call from now on; one line is logged if it cannot.

    Args:
        compiler: a C++ compiler's path.
    """
    try:
        built = _built_for_vectors(compiler)
        library = ctypes.CDLL(str(built), mode=os.RTLD_GLOBAL)
    except (OSError, subprocess.CalledProcessError) as error:
        said = error.stderr if isinstance(error, subprocess.CalledProcessError) else str(error)
        log.warning(
            "matrix products are left to torch: %s does not fit torch %s (%s)",
            SOURCE.name,
            torch.__version__,
            said.strip().partition("\n")[0],
        )
        return None
    library.otc_dist_can_multiply.restype = ctypes.c_bool
    if not library.otc_dist_can_multiply():
        log.info("matrix products are left to torch: this processor lacks the kernel")
        return None
    return built


def _built_for_vectors(compiler: str) -> Path:
    """The library, which shows that the compiler knows the processor's vectors.

    torch would see that by a file for each kind of them and a Python that loads it, 6 s together.

    Raises:
        OSError, subprocess.CalledProcessError: it cannot be made.
    """
    valid_vec_isa_list.cache_clear()
    with config.patch({"cpp.vec_isa_ok": True}):
        widest = pick_vec_isa()  # which torch remembers from now on
    try:
        return _built(compiler, *widest.build_arch_flags().split())
    except subprocess.CalledProcessError:
        valid_vec_isa_list.cache_clear()
        return _built(compiler)


def _built(compiler: str, *flags: str) -> Path:
    """The library, compiled at most once for what it is made of, a torch and a compiler.

    Raises:
        OSError, subprocess.CalledProcessError: it cannot be made.
    """
    sources = SOURCE.read_text() + Path(__file__).read_text()
    made_of = "\0".join((sources, torch.__version__, compiler, *flags))
    library = compiled_root() / f"product-{hashlib.blake2b(made_of.encode()).hexdigest()[:16]}.so"
    if not library.exists():
        with TemporaryDirectory(dir=library.parent) as folder:
            new = Path(folder, library.name)
            command = [compiler, *flags, "-O3", "-shared", "-fPIC", "-std=c++17", str(SOURCE)]
            command += ["-o", str(new), f"-I{TORCH / 'include'}", f"-L{TORCH / 'lib'}"]
            command += ["-ltorch_cpu", "-lc10"]
            subprocess.run(command, check=True, capture_output=True, text=True)
            new.replace(library)
    return library
