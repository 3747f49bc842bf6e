"""Matrix products in compiled code, by our own operation: equal to torch's."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch._inductor.cpu_vec_isa import pick_vec_isa, valid_vec_isa_list
from torch.fx.experimental.proxy_tensor import make_fx

from otc_dist.steps import matrix_products, torch_internals
from otc_dist.steps.engine import Engine

SIDES = {
    "matrices": ((96, 160), (160, 128)),
    "a transposed right": ((96, 160), (128, 160)),
    "a transposed left": ((160, 96), (160, 128)),
    "both transposed": ((160, 96), (7, 160)),
    "a batch": ((3, 64, 200), (3, 200, 96)),
    "a transposed batch": ((3, 64, 200), (3, 96, 200)),
    "every other column": ((32, 20), (10, 16)),
    "one for all of a batch": ((1, 64, 20), (5, 20, 8)),
    "one column": ((128, 256), (256, 1)),
    "one row": ((1, 256), (256, 11)),
    "an outer product": ((128, 1), (1, 64)),
    "numbers": ((1, 1), (1, 1)),
}


def function(name: str) -> Callable[[Tensor, Tensor], Tensor]:
    def multiply(left: Tensor, right: Tensor) -> Tensor:
        left = left.mT if name in ("a transposed left", "both transposed") else left
        left = left[:, ::2] if name == "every other column" else left
        left = left.expand(5, 64, 20) if name == "one for all of a batch" else left
        turned = ("a transposed right", "both transposed", "a transposed batch")
        right = right.mT if name in turned else right
        return torch.relu(torch.matmul(left, right)) + 1

    return multiply


def sides(name: str) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    left, right = (torch.randn(size, generator=generator) for size in SIDES[name])
    return left, right


@pytest.mark.parametrize(("dtype", "count"), [(torch.float32, 1), (torch.float64, 0)])
def test_products_of_single_precision_are_ours(dtype: torch.dtype, count: int) -> None:
    multiply = function("matrices")
    left, right = (side.to(dtype) for side in sides("matrices"))
    traced = make_fx(multiply, tracing_mode="fake")(left, right)
    matrix_products.Products()(traced.graph)
    traced.graph.lint()
    ours = torch.ops.otc_dist.own_product.default
    assert len(traced.graph.find_nodes(op="call_function", target=ours)) == count
    traced.recompile()
    torch.testing.assert_close(traced(left, right), multiply(left, right))


@pytest.mark.slow
@pytest.mark.parametrize("name", SIDES)
def test_compiled_products_equal_eager_ones(name: str) -> None:
    multiply, (left, right) = function(name), sides(name)
    compiled = Engine("compiled", "own").fuse(multiply)
    torch.testing.assert_close(compiled(left, right), multiply(left, right), rtol=1e-5, atol=1e-4)


def test_a_kernel_that_does_not_compile_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """As when another torch has no such kernel: torch's own products serve."""
    broken = tmp_path / "product.cpp"
    broken.write_text("#error no such kernel\n")
    monkeypatch.setattr(matrix_products, "SOURCE", broken)
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path))
    matrix_products.loaded.cache_clear()
    assert not torch_internals.multiplies("g++")
    matrix_products.loaded.cache_clear()
    own = matrix_products.__name__
    (said,) = (record.getMessage() for record in caplog.records if record.name == own)
    assert said.startswith("matrix products are left to torch: product.cpp does not")
    assert "no such kernel" in said and "\n" not in said


@pytest.mark.slow
def test_a_compiler_that_does_not_know_the_vectors_is_asked_by_torch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """torch tries none of those that our own library was compiled for."""
    flags = pick_vec_isa().build_arch_flags().split()
    if not flags:
        pytest.skip("this processor's vectors need no flags")
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path))
    old = tmp_path / "old"
    old.write_text(f'#!/bin/sh\ncase "$*" in *{flags[0]}*) exit 1;; esac\nexec g++ "$@"\n')
    old.chmod(0o755)
    made = set()
    for compiler, trusted in (("g++", 1), (str(old), 0)):
        made.add(matrix_products._built_for_vectors(compiler))
        assert valid_vec_isa_list.cache_info().currsize == trusted
    assert len(made) == 2 and all(path.exists() for path in made)
