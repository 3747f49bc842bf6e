"""What is taken for a machine's name or address, and what is not."""

import pytest

from otc_dist.bus.addresses import is_host


@pytest.mark.parametrize(
    "text", ["a", "gpu_box", "learners.example.org", "x1-2.lan", "192.0.2.1", "::1", "2001:db8::1"]
)
def test_a_host_name_or_an_address_is_a_host(text: str) -> None:
    assert is_host(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        ".",
        "a b",
        "a\n",
        "a..b",
        "-oProxyCommand=x",
        "a-",
        "d;rm",
        "$(x)",
        "\u00e9",
        "192.0.2.300",
        "192.0.2.1:7447",
        "[::1]",
        "fe80::1%;rm",
        64 * "a",
        ".".join(64 * ["aaa"]),
    ],
)
def test_anything_else_is_none(text: str) -> None:
    assert not is_host(text)
