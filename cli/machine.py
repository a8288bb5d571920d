"""Verb `machine`: run on a machine's computer, or stand in for a machine."""

import logging
from pathlib import Path
from typing import Annotated

import tyro
from pydantic import ValidationError

from machine.errors import UsageError
from runtime.process.machine_process import run_machine
from runtime.process.machine_settings import MachineSettings

VIRTUAL_DRIVER = "sim_twin.virtual_machine:VirtualMachine"


def run(
    *,
    machine_id: str,
    data: Path,
    driver: str = "virtual",
    driver_option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = (),
    site: str = "yard",
    connect: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = (),
    username: str | None = None,
    password_file: Path | None = None,
    root_ca_file: Path | None = None,
    server_url: str | None = None,
    policies: Path = Path("policies"),
    calibration: Path | None = None,
    unit_seed: int = 0,
    real_time: bool = True,
) -> None:
    """Run one machine: control loop at 100 Hz, link to the server, throw logs.

    Two processes are started and, if one dies, started again. Stop with Ctrl-C or SIGTERM: a throw before its
    commit point is aborted, one after it is completed first. Without a server the machine keeps its records
    and sends them when there is one.

    A virtual machine beside a server: downrange machine --machine-id m001 --data data/m001 --connect
    tcp/127.0.0.1:7447 --password-file m001.txt --server-url http://127.0.0.1:8000

    A real one: downrange machine --machine-id m007 --data /var/lib/downrange --driver yard_can:Excavator
    --driver-option channel=can0 --connect tls/console.example:7447 --root-ca-file ca.pem --password-file
    /etc/downrange/password --calibration m007.json

    Args:
        machine_id: Name of the machine: 1 to 32 of a-z 0-9 _ -. Also its user name at the server.
        data: Folder of this machine alone: records, throw logs, lease epoch. Survives restarts.
        driver: "virtual", or the machine's own driver as package.module:Class (docs/drivers.md).
        driver_option: Keyword argument of the driver, name=value; may be repeated.
        site: Site whose server this machine belongs to.
        connect: Endpoint of the server's router, e.g. tcp/127.0.0.1:7447 or tls/host:7447; may be repeated.
        username: User name at the server when it is not the machine's name.
        password_file: File with the machine's password, for the link and for uploads.
        root_ca_file: Certificate authority of the server, for tls endpoints.
        server_url: Where logs go and policies come from, e.g. http://127.0.0.1:8000; without it neither.
        policies: Folder of policies with its active.json.
        calibration: Valve tables of this machine, from `downrange calibrate`; without it nominal ones.
        unit_seed: Which of the virtual machines this is; 0 is the nominal one.
        real_time: Ask for real-time scheduling and locked memory; without permission it goes on without.
    """
    logging.basicConfig(level=logging.INFO, format="machine: %(levelname)s %(message)s")
    options: dict[str, str] = {}
    for option in driver_option:
        name, equals, value = option.partition("=")
        if not equals or not name.isidentifier():
            raise UsageError(f"--driver-option {option!r} is not name=value")
        options[name] = value
    try:
        settings = MachineSettings(
            driver=VIRTUAL_DRIVER if driver == "virtual" else driver,
            driver_options=options,
            unit_seed_count=unit_seed,
            machine_id=machine_id,
            site=site,
            connect=connect,
            username=username,
            password_file=password_file,
            root_ca_file=root_ca_file,
            server_url=server_url,
            data_dir=data,
            policies_dir=policies,
            calibration_file=calibration,
            is_real_time=real_time,
        )
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise UsageError(f"settings cannot be used: {faults}") from error
    run_machine(settings)
