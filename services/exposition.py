"""What the env host tells Prometheus when asked: what its statuses tell, and what it counts.

Nothing is computed for it while the run goes on: an answer is made of the newest status, which is
there anyway, and of a few counters.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from otc_dist.bus.messages import Status
from otc_dist.system import extras
from otc_dist.system.ports import Port

_MISSED = ("held", "late", "broken_off")  # of a deployment in real time


@dataclass(frozen=True)
class Counts:
    """Since the process began.

    Attributes:
        lock_steps: questions that all agents have answered.
        resent: questions that an agent was asked once more.
        rejected: messages, by reason.
        returns: the newest of each kind, "greedy" and "measured"; before the first, none.
    """

    lock_steps: int
    resent: int
    rejected: Mapping[str, int]
    returns: Mapping[str, float]


@contextmanager
def exposed(
    port: Port | None, run: str, status: Callable[[], Status], counts: Callable[[], Counts]
) -> Iterator[None]:
    """Meanwhile answer at `http://PORT/metrics`, from threads of its own; at no port: nothing.

    Args:
        run: its name on the bus.
        status, counts: called on another thread, once for each question.

    Raises:
        UserError: prometheus-client is not installed, or nobody can listen there.
    """
    if port is None:
        yield
        return
    extras.check("--prometheus", ["prometheus_client"], "prometheus")
    from prometheus_client import CollectorRegistry, start_http_server
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
    from prometheus_client.registry import Collector

    class Answers(Collector):
        def collect(self) -> Iterator[Metric]:
            now, counted = status(), counts()
            phase = GaugeMetricFamily(
                "otc_phase", "what the env host does", labels=["run", "phase"]
            )
            phase.add_metric([run, now.phase], 1)
            yield phase
            for name, meaning, value in (
                ("deployment", "number of the deployment or evaluation", now.deployment),
                ("step", "lock-steps done in this phase", now.update),
                ("phase_steps", "lock-steps of this phase in all; 0: it has none", now.total),
                ("lock_steps_per_second", "measured between two statuses", now.rate),
                ("awaited_agents", "agents whose answers are overdue", len(now.awaits)),
            ):
                yield GaugeMetricFamily(f"otc_{name}", meaning, value=value)
            for name, meaning, count in (
                ("lock_steps", "lock-steps that all agents have answered", counted.lock_steps),
                ("messages_resent", "questions that an agent was asked again", counted.resent),
            ):
                yield CounterMetricFamily(f"otc_{name}", meaning, value=count)
            rejected = CounterMetricFamily(
                "otc_messages_rejected", "messages that were not accepted", labels=["reason"]
            )
            for reason, count in counted.rejected.items():
                rejected.add_metric([reason], count)
            yield rejected
            returns = GaugeMetricFamily("otc_return", "the newest of each kind", labels=["kind"])
            for kind, value in counted.returns.items():
                returns.add_metric([kind], value)
            yield returns
            missed = GaugeMetricFamily(
                "otc_missed",
                "in real time: actions held, observations late, episodes broken off",
                labels=["kind"],
            )
            for kind in _MISSED:
                if kind in now.metrics:
                    missed.add_metric([kind], now.metrics[kind])
            yield missed

    registry = CollectorRegistry()
    registry.register(Answers())
    try:
        server, thread = start_http_server(port.number, port.host, registry)
    except OSError as error:
        raise port.refused(error) from None
    try:
        yield
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
