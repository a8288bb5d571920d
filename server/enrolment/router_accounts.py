"""Accounts of further routers, under which they call in at the server's router."""

import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.x509.oid import NameOID

from machine.errors import UsageError
from runtime.link.router_file import RouterFile
from runtime.link.zenoh_config import check_name
from server.secret_files import write_secret
from server.settings import Settings

_FOLDER: Final = "routers"


def router_passwords(data_dir: Path) -> dict[str, str]:
    """User name -> password of all further routers."""
    return {
        path.stem: path.read_text(encoding="utf-8").strip()
        for path in sorted((data_dir / _FOLDER).glob("*.password"))
    }


def add_router(settings: Settings, name: str, machines: Mapping[str, str]) -> RouterFile:
    """Make the account of a further router, or take the one that it has.

    Args:
        settings: of the server, whose link has to be encrypted.
        name: of the router.
        machines: machine id -> password of all machines that may call in there.

    Raises:
        UsageError: the name cannot be used, or the server's link has no certificate, address or authority.
    """
    check_name("router", name)
    if name in machines:
        raise UsageError(f"{name} is a machine; a router needs a name of its own")
    certificate, authority = settings.link_certificate, settings.link_root_ca
    if certificate is None or authority is None or settings.link_address is None:
        raise UsageError(
            "routers find each other by certificates: set DOWNRANGE_LINK_LISTEN=tls/..., its certificate and "
            "private key, DOWNRANGE_LINK_ROOT_CA and DOWNRANGE_LINK_ADDRESS"
        )
    path = settings.data_dir / _FOLDER / f"{name}.password"
    if not path.exists():
        write_secret(path, secrets.token_urlsafe(24) + "\n")
    return RouterFile(
        name=name,
        password=router_passwords(settings.data_dir)[name],
        site=settings.site,
        upstream=settings.link_address,
        upstream_common_name=_common_name(certificate),
        root_ca_pem=authority.read_text(encoding="utf-8"),
        machines=dict(machines),
    )


def _common_name(certificate: Path) -> str:
    subject = x509.load_pem_x509_certificate(certificate.read_bytes()).subject
    names = subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    if not names or not isinstance(names[0].value, str):
        raise UsageError(f"{certificate} has no common name; further routers know the server by it")
    return names[0].value
