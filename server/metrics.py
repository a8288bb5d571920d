"""Prometheus metrics, with one registry per application."""

import prometheus_client


class ServiceMetrics:
    """Counters, gauges and histograms of the service."""

    def __init__(self) -> None:
        self.registry = prometheus_client.CollectorRegistry()
        self.command_round_trip_s = prometheus_client.Histogram(
            "downrange_command_round_trip_seconds",
            "From sending a command to the machine's answer",
            ["kind"],
            buckets=(0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5),
            registry=self.registry,
        )
        self.commands_count = self._counter(
            "downrange_commands", "Commands by what became of them", ["kind", "result"]
        )
        self.heartbeats_count = self._counter(
            "downrange_hold_heartbeats", "Hold messages relayed to machines", ["result"]
        )
        self.events_count = self._counter(
            "downrange_machine_events", "Machine events stored", ["kind"]
        )
        self.event_repeats_count = self._counter(
            "downrange_machine_event_repeats", "Machine events that were already stored"
        )
        self.event_batches_refused_count = self._counter(
            "downrange_event_batches_refused", "Batches left for the machine to repeat"
        )
        self.unreadable_count = self._counter(
            "downrange_unreadable_messages", "Messages from machines that could not be read"
        )
        self.streams_refused_count = self._counter(
            "downrange_streams_refused",
            "Streams beyond what one person or address may open",
            ["kind"],
        )
        self.requests_s = prometheus_client.Histogram(
            "downrange_http_request_seconds",
            "HTTP requests by operation",
            ["operation", "status"],
            buckets=(0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0),
            registry=self.registry,
        )
        self.loop_lag_s = self._gauge(
            "downrange_event_loop_lag_seconds", "How late the event loop wakes"
        )
        self.machines_connected_count = self._gauge(
            "downrange_machines_connected", "Machines with a fresh state"
        )
        self.event_clients_count = self._gauge(
            "downrange_event_clients", "Browsers that listen to events"
        )
        self.outbox_count = self._gauge(
            "downrange_machine_outbox", "Records waiting on a machine", ["machine_id"]
        )

    def _counter(
        self, name: str, text: str, labels: list[str] | None = None
    ) -> prometheus_client.Counter:
        return prometheus_client.Counter(name, text, labels or [], registry=self.registry)

    def _gauge(
        self, name: str, text: str, labels: list[str] | None = None
    ) -> prometheus_client.Gauge:
        return prometheus_client.Gauge(name, text, labels or [], registry=self.registry)

    def page(self) -> bytes:
        """The metrics in Prometheus' text format."""
        return prometheus_client.generate_latest(self.registry)
