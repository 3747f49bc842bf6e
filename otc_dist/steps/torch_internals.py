"""All that we use of torch and torch does not promise to keep, behind one question: `usable`.

Plain `torch.compile` computes the same without any of it, more slowly and, without our own matrix
products, rounded otherwise. So if the installed torch lacks a part, or a part behaves otherwise
there, one line is logged and all of them are left out.
"""

import functools
import logging
import os
import re
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from otc_dist.steps.state import P, T

if TYPE_CHECKING:
    from torch._inductor.custom_graph_pass import CustomGraphPass

Guards = Callable[[Sequence[Any]], list[bool]]
VARIANTS = 256  # of one function in a process: agents differ in sizes, arms in samplers
# torch.cond's branches are part of the cache's key, but torch has not declared it cacheable.
CACHEABLE = {"torch.ops.higher_order.cond": torch.__version__}
# What `torch.compile` must know beside the filter of guards.
OPTIONS = (
    "cpp_wrapper",
    "unsafe_marked_cacheable_functions",
    "post_grad_custom_pre_pass",
    "size_asserts",
)
TESTED = "2.13.0"  # the torch in constraints.txt
HEADERS = "cpp_cache_precompile_headers"
log = logging.getLogger(__name__)


def options(arguments: Collection[str], on_cpu: bool, compiler: str | None) -> dict[str, Any]:
    """What `torch.compile` is given to compile a function; where that is not to be had, nothing
    but that no headers are compiled first: `_keep_headers_private` says what is wrong with those.

    Args:
        arguments: the names of the function's arguments.
        compiler: the path of a C++ compiler if float32 products are to be ours (see `multiplies`).
    """
    if not usable():
        return {HEADERS: False} if HEADERS in torch._inductor.list_options() else {}
    chosen: dict[str, Any] = {
        "guard_filter_fn": _on(arguments),
        "unsafe_marked_cacheable_functions": CACHEABLE,
    }
    # torch's compiler takes a second to import.
    from otc_dist.steps import matrix_products, repeated_terms

    passes: list[CustomGraphPass] = [repeated_terms.RepeatedTerms()]
    if on_cpu:
        chosen["cpp_wrapper"] = True
        chosen["size_asserts"] = False  # of what products return, at every call
    if compiler:
        passes += matrix_products.passes(compiler)
    return chosen | {"post_grad_custom_pre_pass": passes}


def called_directly(compiled: Callable[P, T]) -> Callable[P, T]:
    """The same function, called without what torch does around its code; where that is not to be
    had, itself.

    Args:
        compiled: what `torch.compile` made for the CPU of a pure function.
    """
    if not usable():
        return compiled
    from otc_dist.steps import direct_calls

    return direct_calls.DirectCalls(compiled)


@functools.cache
def usable() -> bool:
    """Whether the installed torch has all of it, as we know it; one line is logged if not."""
    try:
        _prepare()
        _check_guards()
    except Exception as error:  # whatever another torch may say
        log.warning(
            "updates are compiled by plain torch.compile: torch %s differs from what we know (%s)",
            torch.__version__,
            _line(error),
        )
        return False
    return True


def compile_headers() -> None:
    """Compile what all compiled code includes, unless that was done; it takes g++ 5 s.

    torch would do it when there is code to compile, and nothing else meanwhile. If it fails, so
    will the code, which says why.
    """
    if not usable():
        return
    from torch._inductor.codecache import CppWrapperCodeCache

    with suppress(Exception):
        CppWrapperCodeCache.load_async("", device_type="cpu", needs_vec_isa=True)


def multiplies(compiler: str) -> bool:
    """Whether compiled code may call our own kernel for products; one line is logged if not.

    Args:
        compiler: a C++ compiler's path.
    """
    if not usable():
        return False
    from otc_dist.steps import matrix_products

    return matrix_products.loaded(compiler) is not None


def try_product(compiler: str) -> str:
    """What is wrong with products of our own in what this torch compiles; nothing: "".

    A small one is tried, once for each torch but the one that the tests run with. It takes as long
    as the headers that all compiled code includes, which are compiled first.

    Args:
        compiler: a C++ compiler's path.
    """
    from otc_dist.steps import matrix_products

    library = matrix_products.loaded(compiler)
    if library is None or torch.__version__.partition("+")[0] == TESTED:
        return ""
    if (tried := library.with_suffix(".tried")).exists():
        return ""
    left, right = torch.arange(6.0).reshape(2, 3), torch.arange(12.0).reshape(3, 4)
    chosen = options(("left", "right"), on_cpu=True, compiler=compiler)
    try:
        compiled = torch.compile(_product, fullgraph=True, dynamic=False, options=chosen)
        if not torch.equal(compiled(left, right), _product(left, right)):
            return "a product is wrong"
    except Exception as error:  # whatever another torch may say
        return _line(error)
    tried.touch()
    return ""


def _product(left: Tensor, right: Tensor) -> Tensor:
    return left @ right + 1


def _prepare() -> None:
    """Raises an error if torch lacks something that holds for all that is compiled."""
    # The default of 8 ends a process that holds more brains than that with an error.
    torch._dynamo.config.recompile_limit = VARIANTS
    # Which may not be importable there.
    from otc_dist.steps import direct_calls, matrix_products, repeated_terms  # noqa: F401

    direct_calls.check()
    known = torch._inductor.list_options()
    if missing := [name for name in OPTIONS if name not in known]:
        raise AttributeError(f"it has no option {missing[0]}")
    _keep_headers_private()


def _keep_headers_private() -> None:
    """torch keeps the headers that it compiles first in a folder of a known name under /tmp, which
    anybody may make before us: they go where the rest of the compiled code is.
    """
    from torch._inductor import codecache

    headers = Path(os.environ["TORCHINDUCTOR_CACHE_DIR"], "precompiled_headers")
    for name, folder in (("_HEADER_DIR", headers), ("_HEADER_LOCK_DIR", headers / "locks")):
        getattr(codecache, name)  # else it would be set to no purpose
        setattr(codecache, name, str(folder))


def _check_guards() -> None:
    """Raises an error if guards cannot be told apart by the names that they have."""
    scale, left_out = 2.0, 0

    def scaled(state: dict[str, Tensor], rows: Tensor) -> Tensor:
        return torch.stack(list(state.values())).sum() * scale / len(rows)

    scaled.__code__ = scaled.__code__.replace()  # which torch has not compiled before

    def on_arguments(guards: Sequence[Any]) -> list[bool]:
        nonlocal left_out
        kept = _on(("state", "rows"))(guards)
        left_out += kept.count(False)
        return kept

    compiled = torch.compile(
        scaled,
        backend="eager",
        fullgraph=True,
        dynamic=False,
        options={"guard_filter_fn": on_arguments},
    )
    for names, rows in (("a", 3), ("a", 4), ("ab", 4), ("a", 3)):
        state, data = {name: torch.ones(()) for name in names}, torch.ones(rows)
        if compiled(state, data) != scaled(state, data):
            raise ValueError("a guard on an argument is not known by its name")
    if not left_out:
        raise ValueError("guards on arguments are not told from others")


def _on(arguments: Collection[str]) -> Guards:
    """Which of torch's conditions on compiled code to check before a call: those on arguments.

    What else a function looks at is part of what makes it (see `engine`), and torch would compare
    all of that before every call.
    """
    wanted = {"", *arguments}

    def kept(guards: Sequence[Any]) -> list[bool]:
        roots = [re.match(r"\w*", guard.name) for guard in guards]
        return [root is not None and root[0] in wanted for root in roots]

    return kept


def _line(error: Exception) -> str:
    """The first line of what an error says."""
    return str(error).strip().partition("\n")[0] or type(error).__name__
