"""`downrange router`: a further router of the site, at which machines of another network call in."""

import signal
import threading
from pathlib import Path
from typing import Annotated

import tyro
import zenoh

from machine.errors import UsageError
from runtime.link.router_file import read_router_file
from runtime.link.zenoh_config import RouterTls
from server.accounts.audit_chain import SERVER, AuditChain, Entry
from server.enrolment.router_accounts import add_router
from server.machines.machine_registry import MachineRegistry
from server.secret_files import write_secret
from server.settings import load_settings
from server.store.database import Database


def add(
    name: Annotated[str, tyro.conf.Positional],
    /,
    *,
    output: Annotated[Path, tyro.conf.arg(name="output", aliases=["-o"])],
    data: Path | None = None,
) -> int:
    """Make a router's account and its file, on the server's computer.

    A running server takes the account within seconds, when no machine is armed or throws. Again with the
    same name after machines were added or retired: the account stays.

    Args:
        name: of the router, a-z 0-9 _ -.
        output: file to write; it holds the passwords of all machines.
        data: the server's data folder; DOWNRANGE_DATA_DIR if not given.
    """
    settings = load_settings(data_dir=data)
    database = Database(settings.resolved_database_url)
    try:
        database.require_current()
        audit = AuditChain(database, settings.data_dir / "audit-anchors.jsonl")
        registry = MachineRegistry(database, audit, settings.site, settings.data_dir)
        file = add_router(settings, name, registry.passwords())
        audit.record(Entry(SERVER, "router.add", "fact", detail={"router": name}))
    finally:
        database.close()
    write_secret(output, file.model_dump_json(indent=1))
    print(f"{output}: router {name} with {len(file.machines)} machines; keep it secret")
    return 0


def run(
    file: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    listen: str,
    data: Path,
    certificate: Path | None = None,
    private_key: Path | None = None,
) -> int:
    """Run a further router until SIGTERM or Ctrl-C.

    Args:
        file: what `downrange router add` wrote.
        listen: endpoint at which machines call in, tls/HOST:PORT; tcp/... only on one computer.
        data: folder for Zenoh's files.
        certificate: of a tls/... endpoint, PEM.
        private_key: its private key, PEM.
    """
    tls = None
    if certificate is not None and private_key is not None:
        tls = RouterTls(certificate, private_key)
    if (tls is not None) != listen.startswith("tls/"):
        raise UsageError("a tls/... endpoint needs --certificate and --private-key; no other does")
    router = read_router_file(file)
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    try:
        session = zenoh.open(router.config(listen, data, tls))
    except zenoh.ZError as error:
        raise UsageError(f"the router cannot listen at {listen} ({error})") from error
    with session:
        print(f"Router {router.name} listens at {listen}", flush=True)
        ended.wait()
    return 0


ACTIONS = {"add": add, "run": run}
