"""What torch does not promise to keep: without it, plain `torch.compile` does the same."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch._dynamo import guards
from torch._inductor import codecache, output_code

from otc_dist.description.sections import EngineSection
from otc_dist.steps import engine, matrix_products, torch_internals
from otc_dist.steps.engine import Engine
from otc_dist.terminal.errors import UserError

Patch = Callable[[pytest.MonkeyPatch], None]


def square(x: Tensor) -> Tensor:
    return x * x


def _no_pass(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(sys.modules, "otc_dist.steps.matrix_products", None)
    patch.delattr("otc_dist.steps.matrix_products")


# What another torch may be like, and what is then said of it.
OTHERS: dict[str, tuple[Patch, str]] = {
    "no such option": (
        lambda patch: patch.setattr(torch._inductor, "list_options", lambda: ["max_autotune"]),
        "it has no option cpp_wrapper",
    ),
    "no such folder": (
        lambda patch: patch.delattr(codecache, "_HEADER_LOCK_DIR"),
        "_HEADER_LOCK_DIR",
    ),
    "no such pass": (
        _no_pass,
        "matrix_products",
    ),
    "code kept elsewhere": (
        lambda patch: patch.delitem(
            output_code.CompiledFxGraph.__annotations__, "current_callable"
        ),
        "CompiledFxGraph has no current_callable",
    ),
    "other names of guards": (
        lambda patch: patch.setattr(guards, "strip_local_scope", lambda name: name),
        "a guard on an argument is not known by its name",
    ),
}


@pytest.fixture
def forgotten() -> Iterator[None]:
    """What was found out about the installed torch is found out again, before and after."""
    torch_internals.usable.cache_clear()
    yield
    torch_internals.usable.cache_clear()


@pytest.mark.parametrize("other", OTHERS)
def test_another_torch_is_one_line_and_the_plain_way(
    other: str,
    forgotten: None,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    change, told = OTHERS[other]
    # In whose folder, under /tmp, they would lie is then not known.
    plain = {} if other == "no such option" else {"cpp_cache_precompile_headers": False}
    change(monkeypatch)
    assert torch_internals.options(("rows",), on_cpu=True, compiler="g++") == plain
    assert not torch_internals.multiplies("g++")
    assert torch_internals.called_directly(square) is square
    (said,) = (one.getMessage() for one in caplog.records if one.name == torch_internals.__name__)
    assert said.startswith("updates are compiled by plain torch.compile: torch") and told in said
    assert "\n" not in said


def test_the_torch_that_is_tested_has_it_all(
    forgotten: None, caplog: pytest.LogCaptureFixture
) -> None:
    tested = (Path(__file__).parents[2] / "constraints.txt").read_text().splitlines()
    assert f"torch=={torch_internals.TESTED}" in tested
    if f"torch=={torch.__version__.partition('+')[0]}" not in tested:
        pytest.skip("another torch may lack something")
    engine._keep_compiled()
    assert torch_internals.usable()
    assert not [one for one in caplog.records if one.name == torch_internals.__name__]


@pytest.mark.slow
def test_a_torch_that_compiles_products_wrongly_is_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    own = EngineSection(name="compiled", products="own")
    if engine.resolve(EngineSection(name="compiled"), 1) != own:
        pytest.skip("this processor has no such kernel")
    library = tmp_path / "product.so"  # which was not tried
    monkeypatch.setattr(torch_internals, "TESTED", "another torch")
    monkeypatch.setattr(matrix_products, "loaded", lambda compiler: library)
    monkeypatch.setattr(torch, "equal", lambda *tensors: False)
    with pytest.raises(
        UserError, match=r"fail with torch .* \(a product is wrong\); start with --set"
    ):
        engine.check(own)
    monkeypatch.undo()
    monkeypatch.setattr(matrix_products, "loaded", lambda compiler: library)
    engine.check(own)  # the torch that all tests run with is not tried again
    assert not library.with_suffix(".tried").exists()
    monkeypatch.setattr(torch_internals, "TESTED", "another torch")
    engine.check(own)
    assert library.with_suffix(".tried").exists()


@pytest.mark.slow
def test_the_plain_way_computes_the_same(forgotten: None, monkeypatch: pytest.MonkeyPatch) -> None:
    OTHERS["no such option"][0](monkeypatch)

    def layer(rows: Tensor, weight: Tensor) -> Tensor:
        return torch.relu(rows @ weight).sum(0)

    left, right = torch.rand(7, 5), torch.rand(5, 3)
    plain = Engine("compiled", "own").fuse(layer)
    torch.testing.assert_close(plain(left, right), layer(left, right))
