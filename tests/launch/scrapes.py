"""What a Prometheus, or a browser, would read."""

import socket
import urllib.request

from prometheus_client.parser import text_string_to_metric_families


def free_port() -> int:
    with socket.socket() as there:
        there.bind(("127.0.0.1", 0))
        port: int = there.getsockname()[1]
    return port


def asked_of(port: int, path: str) -> str:
    """The answer of a server of ours."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}", timeout=60) as answer:
        text: str = answer.read().decode()
    return text


def scraped(port: int) -> dict[tuple[str, str], float]:
    """(name, its label but the run's, or "") -> value."""
    text = asked_of(port, "metrics")
    return {
        (
            sample.name,
            "".join(x for name, x in sample.labels.items() if name != "run"),
        ): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }
