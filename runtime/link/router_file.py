"""The file that sets up a further router of the site on another computer."""

from pathlib import Path
from typing import Final

import zenoh
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from machine.errors import UsageError
from runtime.link.zenoh_config import RouterTls, Upstream, router_config

USERS_FILE: Final = "users.txt"
ROOT_CA_FILE: Final = "root-ca.pem"


class RouterFile(BaseModel):
    """What a further router has to know of its site; it holds the passwords of its machines."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str
    """Also the user name under which it calls in at the server."""
    password: str
    site: str
    upstream: str = Field(pattern=r"^tls/[^/]+:\d{1,5}$")
    """Endpoint of the server's router."""
    upstream_common_name: str
    """Common name of that endpoint's certificate."""
    root_ca_pem: str
    """Authority of that certificate."""
    machines: dict[str, str]
    """Machine id -> password."""

    def config(self, listen: str, folder: Path, tls: RouterTls | None) -> zenoh.Config:
        """Configuration of the router.

        Args:
            listen: endpoint at which machines call in.
            folder: where Zenoh's files are written, one router a folder.
            tls: of a ``tls/...`` endpoint.

        Raises:
            UsageError: a name or password that cannot be used.
        """
        folder.mkdir(parents=True, exist_ok=True)
        root_ca = folder / ROOT_CA_FILE
        root_ca.write_text(self.root_ca_pem, encoding="utf-8")
        return router_config(
            listen=(listen,),
            users=self.machines,
            machines=sorted(self.machines),
            site=self.site,
            dictionary_file=folder / USERS_FILE,
            tls=tls,
            upstream=Upstream(
                self.upstream, self.name, self.password, self.upstream_common_name, root_ca
            ),
        )


def read_router_file(path: Path) -> RouterFile:
    """Read what `downrange router add` wrote.

    Raises:
        UsageError: there is no such file, or it holds something else.
    """
    try:
        return RouterFile.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise UsageError(f"{path} is no file of `downrange router add` ({error})") from error
