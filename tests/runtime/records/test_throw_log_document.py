"""docs/throw_log.md says what the code does."""

import re
from pathlib import Path

from machine.channels import LOG_CHANNELS
from runtime.records.throw_log import (
    CONTEXT_RECORD,
    LOG_SCHEMA_VERSION,
    PROFILE,
    RESULT_RECORD,
    ROW_TYPES,
)
from tests.cases import each

TEXT = (Path(__file__).parents[3] / "docs/throw_log.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    return TEXT.split(f"### `{title}`\n")[1].split("\n#")[0]


def keys(table: str) -> list[str]:
    rows = [line for line in table.splitlines() if line.startswith("| `")]
    return [key for row in rows for key in re.findall(r"`([\w.]+)`", row.split("|")[1])]


@each("name", sorted(ROW_TYPES))
def test_every_field_is_described_in_order_with_its_size(name):
    text = section(LOG_CHANNELS[name].topic)
    assert keys(text) == list(ROW_TYPES[name].names)
    for field in ROW_TYPES[name].names:
        shape = ROW_TYPES[name][field].shape
        row = next(line for line in text.splitlines() if f"`{field}`" in line)
        assert not shape or f"({shape[0]})" in row


def test_every_channel_is_listed_with_its_rate():
    for channel in LOG_CHANNELS.values():
        row = next(line for line in TEXT.splitlines() if line.startswith(f"| `{channel.topic}`"))
        if channel.rate_hz:
            assert f"{channel.rate_hz:g} Hz" in row


def test_context_and_result_keys_are_listed(bench):
    assert bench.ask(bench.fire_command(bench.arm())).accepted
    bench.hold_until("throw_ended")
    context = next(r.log_begins for r in bench.reports if r.log_begins is not None)
    result = next(r.log_ends for r in bench.reports if r.log_ends is not None)
    described = set(keys(TEXT.split(f"**`{CONTEXT_RECORD}`**")[1].split("## Channels")[0]))
    written = {"log_schema_version", "is_complete", "dropped_count", "row_count"}
    assert set(context) | set(result) | written == described


def test_constants_are_those_of_the_code():
    assert f"profile `{PROFILE}`" in TEXT
    assert f"integer, {LOG_SCHEMA_VERSION}: version" in TEXT
    assert f"**`{RESULT_RECORD}`**" in TEXT
