"""An endpoint of each test's own."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from otc_dist.bus.endpoints import local_endpoint, remove_local_endpoint


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[str]:
    made = local_endpoint(tmp_path)
    yield made
    remove_local_endpoint(made)
