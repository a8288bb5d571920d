"""Verb `machine`: run on a machine's computer, or stand in for a machine."""

import logging
import sys
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final
from urllib.parse import urlsplit

import tyro
from pydantic import ValidationError

from machine.errors import UsageError
from runtime.enrolment.claim import EnrolmentError, claim, report_self_test, server_time
from runtime.enrolment.enrolment_file import (
    ENROLMENT_FILE,
    PASSWORD_FILE,
    ROOT_CA_FILE,
    EnrolmentFile,
    read_enrolment,
    write_private,
)
from runtime.enrolment.self_test import TestItem, self_test
from runtime.policies.slots import PolicySlots
from runtime.process.machine_process import machine_lock, run_machine
from runtime.process.machine_settings import MachineSettings

VIRTUAL_DRIVER = "sim_twin.virtual_machine:VirtualMachine"
LOOPBACK: Final = frozenset({"localhost", "127.0.0.1", "::1"})


def run(
    *,
    data: Path,
    machine_id: str | None = None,
    driver: str | None = None,
    driver_option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = (),
    site: str | None = None,
    connect: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = (),
    username: str | None = None,
    password_file: Path | None = None,
    root_ca_file: Path | None = None,
    server_url: str | None = None,
    site_key: str | None = None,
    policies: Path | None = None,
    calibration: Path | None = None,
    unit_seed: int | None = None,
    real_time: bool = True,
) -> None:
    """Run one machine: control loop at 100 Hz, link to the server, throw logs.

    Two processes are started and, if one dies, started again. Stop with Ctrl-C or SIGTERM: a throw before its
    commit point is aborted, one after it is completed first. Without a server records wait on the disk.

    A machine that was set up by `downrange machine enrol` needs its folder only: downrange machine --data
    data/m001. `downrange machine self-test --data data/m001` tests it again while it does not run.

    A virtual machine beside a server: downrange machine --machine-id m001 --data data/m001 --connect
    tcp/127.0.0.1:7447 --password-file m001.txt --server-url http://127.0.0.1:8000

    A real one: downrange machine --machine-id m007 --data /var/lib/downrange --driver yard_can:Excavator
    --driver-option channel=can0 --connect tls/console.example:7447 --root-ca-file ca.pem --password-file
    /etc/downrange/password --calibration m007.json

    Args:
        data: Folder of this machine alone: records, throw logs, lease epoch. Survives restarts.
        machine_id: Name of the machine: 1 to 32 of a-z 0-9 _ -. Also its user name at the server.
        driver: "virtual" (the usual), or the machine's own driver as package.module:Class (docs/drivers.md).
        driver_option: Keyword argument of the driver, name=value; may be repeated.
        site: Site whose server this machine belongs to; usually yard.
        connect: Endpoint of the server's router, e.g. tcp/127.0.0.1:7447 or tls/host:7447; may be repeated.
        username: User name at the server when it is not the machine's name.
        password_file: File with the machine's password, for the link and for uploads.
        root_ca_file: Certificate authority of the server, for tls endpoints.
        server_url: Where logs go and policies come from, e.g. http://127.0.0.1:8000; without it neither.
        site_key: Id of the site's key that may bind the machine, or "refuse"; usually the first it meets.
        policies: Folder of policies with its active.json.
        calibration: Valve tables of this machine, from `downrange calibrate`; without it nominal ones.
        unit_seed: Which of the virtual machines this is; 0 is the nominal one.
        real_time: Ask for real-time scheduling and locked memory; without permission it goes on without.
    """
    logging.basicConfig(level=logging.INFO, format="machine: %(levelname)s %(message)s")
    enrolment = read_enrolment(data)
    if enrolment is None and machine_id is None:
        raise UsageError(
            f"{data} is no folder of an enrolled machine: name --machine-id, or set the machine up with "
            "`downrange machine enrol`"
        )
    given: dict[str, Any] = {
        "driver": None if driver is None else driver_name(driver),
        "driver_options": driver_options(driver_option) or None,
        "unit_seed_count": unit_seed,
        "machine_id": machine_id,
        "site": site,
        "connect": connect or None,
        "username": username,
        "password_file": password_file,
        "root_ca_file": root_ca_file,
        "server_url": server_url,
        "site_key": site_key,
        "policies_dir": policies,
        "calibration_file": calibration,
    }
    known: dict[str, Any] = (
        {"driver": VIRTUAL_DRIVER, "site": "yard", "policies_dir": Path("policies")}
        if enrolment is None
        else enrolment.settings(data).model_dump()
    )
    known |= {name: value for name, value in given.items() if value is not None}
    known |= {"data_dir": data, "is_real_time": real_time}
    run_machine(_settings(known))


def _settings(values: dict[str, Any]) -> MachineSettings:
    try:
        return MachineSettings.model_validate(values)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise UsageError(f"settings cannot be used: {faults}") from error


def driver_name(driver: str) -> str:
    """The driver's ``package.module:Class``."""
    return VIRTUAL_DRIVER if driver == "virtual" else driver


def driver_options(options: tuple[str, ...]) -> dict[str, str]:
    """Keyword arguments of a driver.

    Raises:
        UsageError: one is not ``name=value``.
    """
    found: dict[str, str] = {}
    for option in options:
        name, equals, value = option.partition("=")
        if not equals or not name.isidentifier():
            raise UsageError(f"--driver-option {option!r} is not name=value")
        found[name] = value
    return found


def enrol(
    *,
    server: str,
    token: str,
    data: Path,
    site_key: str | None = None,
    driver: str = "virtual",
    driver_option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = (),
    root_ca_file: Path | None = None,
    policies: Path = Path("policies"),
    calibration: Path | None = None,
    unit_seed: int = 0,
) -> int:
    """Set this computer up as a machine of a server, and test it; the token is on page Fleet, Add machine.

    Credentials and the server's addresses go into the folder, the site's keys as well. Nothing moves. Then:
    downrange machine --data DIR

    Args:
        server: Address of the console, e.g. https://console.example.
        token: One-time token of page Fleet; it works once, within the hour.
        data: Folder of this machine alone; must not belong to another machine.
        site_key: Id of the site's key, from page Fleet: another is refused. Without it, compare it there.
        driver: "virtual", or the machine's own driver as package.module:Class (docs/drivers.md).
        driver_option: Keyword argument of the driver, name=value; may be repeated.
        root_ca_file: Certificate authority of the router, where the server does not hand it over.
        policies: Folder of policies with its active.json.
        calibration: Valve tables of this machine; without it nominal ones.
        unit_seed: Which of the virtual machines this is.
    """
    if not server.startswith(("http://", "https://")):
        raise UsageError(f"--server {server!r} is no address; as in https://console.example")
    if read_enrolment(data) is not None:
        raise UsageError(f"{data} belongs to an enrolled machine; name another --data")
    for option, path in (
        ("--root-ca-file", root_ca_file),
        ("--calibration", calibration),
        ("--policies", policies),
    ):
        if path is not None and not path.exists():
            raise UsageError(f"{option} {path.absolute()} does not exist; name where it is")
    # A token works once: whatever can be wrong here is found before it is used.
    options, driver = driver_options(driver_option), driver_name(driver)
    data.mkdir(parents=True, exist_ok=True)
    warn_in_the_clear(server)
    credentials = claim(server, token)
    offset_s = (datetime.now(UTC) - credentials.server_utc).total_seconds()
    print(f"{credentials.machine_id} of site {credentials.site}; its credentials lie in {data}")
    write_private(data / PASSWORD_FILE, credentials.password + "\n")
    authority = None if root_ca_file is None else root_ca_file.resolve()
    if credentials.root_ca_pem is not None and authority is None:
        authority = (data / ROOT_CA_FILE).resolve()
        write_private(authority, credentials.root_ca_pem)
    enrolment = EnrolmentFile(
        machine_id=credentials.machine_id,
        site=credentials.site,
        connect=credentials.connect,
        server_url=server,
        driver=driver,
        driver_options=options,
        unit_seed_count=unit_seed,
        root_ca_file=authority,
        policies_dir=policies.resolve(),
        calibration_file=None if calibration is None else calibration.resolve(),
    )
    # First: a machine whose file is there is bound to its site.
    PolicySlots(enrolment.settings(data).policy_slots_dir).keep_trust(credentials.trust, site_key)
    key = credentials.trust.signed_by
    check = "as was asked for" if site_key else "compare it with page Policies of the console"
    print(f"loads policies that key {key} of site {credentials.site} has signed; {check}")
    write_private(data / ENROLMENT_FILE, enrolment.model_dump_json(indent=2) + "\n")
    return _test(enrolment, data, offset_s)


def warn_in_the_clear(server: str) -> None:
    """Warn where the password would travel over a network unencrypted."""
    if server.startswith("http://") and urlsplit(server).hostname not in LOOPBACK:
        print(
            f"{server} is not encrypted: who listens on the network learns this machine's password. "
            "Use https:// (docs/operations.md, Encryption).",
            file=sys.stderr,
        )


def repeat_self_test(*, data: Path) -> int:
    """Test an enrolled machine again while it does not run; the server gets the result.

    Args:
        data: Folder of the machine.
    """
    enrolment = read_enrolment(data)
    if enrolment is None:
        raise UsageError(f"{data} is no folder of an enrolled machine")
    try:
        offset_s = (datetime.now(UTC) - server_time(enrolment.server_url)).total_seconds()
    except EnrolmentError:
        offset_s = None
    return _test(enrolment, data, offset_s)


def _test(enrolment: EnrolmentFile, data: Path, offset_s: float | None) -> int:
    """Test, print, report; 1 where the machine cannot work as it is."""
    settings = enrolment.settings(data)
    with machine_lock(settings):
        items = self_test(
            settings,
            offset_s,
            lambda item: print(f"  {_mark(item):<7} {item.name:<12} {item.detail}"),
        )
    report_self_test(
        enrolment.server_url,
        enrolment.machine_id,
        settings.password(),
        [asdict(item) for item in items],
    )
    failed = [item.name for item in items if not item.is_passed and item.name != "calibration"]
    if failed:
        print(f"mend {', '.join(failed)}, then: downrange machine self-test --data {data}")
        return 1
    print(f"start it: downrange machine --data {data}")
    return 0


def _mark(item: TestItem) -> str:
    return "ok" if item.is_passed else "MISSING" if item.name == "calibration" else "FAILED"


ACTIONS = {"enrol": enrol, "self-test": repeat_self_test}
