"""Uploads against a real HTTP server: repeated until stored, in order, and never in each other's way."""

import hashlib
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from machine.messages import EventKind
from runtime.records.journal import Journal
from runtime.records.log_upload import LogUploader, UploadOutcome, UploadTarget, upload_log
from runtime.records.log_writer import StoredLog
from runtime.records.outbox import EventDraft, Outbox
from runtime.records.recorder import log_path
from tests.cases import each


class Server(ThreadingHTTPServer):
    """Answers PUTs with the given statuses, 204 by default."""

    daemon_threads = True

    def __init__(self) -> None:
        self.statuses: dict[str, list[int]] = {}
        self.stored: dict[str, bytes] = {}
        self.headers: list[dict[str, str]] = []
        self.is_enough = threading.Event()
        self.wanted_count = 10**6
        super().__init__(("127.0.0.1", 0), Handler)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_PUT(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        name = self.path.rsplit("/", 1)[1]
        self.server.headers.append(dict(self.headers) | {"path": self.path})
        waiting = self.server.statuses.get(name, [])
        status = waiting.pop(0) if waiting else 204
        if status == 204:
            self.server.stored[name] = body
        self.send_response(status)
        self.send_header("Content-Length", "0")
        self.end_headers()
        if len(self.server.stored) >= self.server.wanted_count:
            self.server.is_enough.set()

    def log_message(self, *_: object) -> None:
        return


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    outbox = Outbox(tmp_path / "m.db", "m001")
    yield Journal(outbox)
    outbox.close()


def add_logs(journal: Journal, folder: Path, *throw_ids: str) -> None:
    for number, throw_id in enumerate(throw_ids, 1):
        draft = EventDraft(EventKind.THROW_ACCEPTED, 1, throw_id, None, {}, "now")
        journal.record("boot", number, draft)
        path = log_path(folder, throw_id)
        path.write_bytes(throw_id.encode() * 10)
        journal.add_log("boot", StoredLog(throw_id, path, "0" * 64, 10), 1)


def target(server: Server) -> UploadTarget:
    return UploadTarget(server.url + "/", "m001", "secret")


def test_request_carries_token_and_hash(server):
    assert upload_log(target(server), "t1", b"content") is UploadOutcome.STORED
    (headers,) = server.headers
    assert headers["path"] == "/api/v1/machines/m001/throw-logs/t1"
    assert headers["Authorization"] == "Bearer secret"
    assert headers["X-Content-Sha256"] == hashlib.sha256(b"content").hexdigest()
    assert server.stored == {"t1": b"content"}


@each(
    ("status", "outcome"),
    [
        (204, UploadOutcome.STORED),
        (413, UploadOutcome.REFUSED),
        (422, UploadOutcome.REFUSED),
        (401, UploadOutcome.RETRY),
        (404, UploadOutcome.RETRY),
        (503, UploadOutcome.RETRY),
    ],
)
def test_statuses_decide_whether_to_try_again(server, status, outcome):
    server.statuses["t1"] = [status]
    assert upload_log(target(server), "t1", b"x") is outcome


def test_nobody_there_is_a_reason_to_try_again():
    assert (
        upload_log(UploadTarget("http://127.0.0.1:9", "m001", "s"), "t1", b"x")
        is UploadOutcome.RETRY
    )


def test_one_unwanted_log_holds_up_no_other(server, journal, tmp_path):
    add_logs(journal, tmp_path, "t1", "t2", "t3")
    server.statuses["t1"] = [404]
    uploader = LogUploader(target(server), journal, tmp_path)
    assert uploader.send_all() == (False, True)
    assert set(server.stored) == {"t2", "t3"}
    assert journal.to_upload() == ("t1",)
    assert uploader.send_all() == (False, True)
    assert uploader.send_all() == (True, False)


def test_log_that_is_gone_or_refused_for_good_is_not_tried_for_ever(server, journal, tmp_path):
    add_logs(journal, tmp_path, "t1", "t2")
    log_path(tmp_path, "t1").unlink()
    server.statuses["t2"] = [422]
    LogUploader(target(server), journal, tmp_path).send_all()
    assert journal.to_upload() == ()
    assert server.stored == {}


def test_thread_sends_old_and_new_logs_and_stops(server, journal, tmp_path):
    server.wanted_count = 2
    add_logs(journal, tmp_path, "t1")
    server.statuses["t1"] = [503]
    uploader = LogUploader(target(server), journal, tmp_path)
    uploader.start()
    add_logs(journal, tmp_path, "t1", "t2")
    uploader.wake()
    assert server.is_enough.wait(20.0)
    uploader.close()
    assert server.stored == {"t1": b"t1" * 10, "t2": b"t2" * 10}
