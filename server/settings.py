"""Settings of the web service: from the environment alone, checked, printed with secrets hidden.

Operator preferences are in the database, machine truth in spec.json; neither is here.
"""

import ipaddress
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, SecretStr, ValidationError, field_validator, model_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from machine.errors import UsageError

PREFIX = "DOWNRANGE_"
CLIENT_VARIABLES = frozenset({"DOWNRANGE_USER", "DOWNRANGE_PASSWORD_FILE"})
"""Read by `downrange throw`; a shell that sets them may start a server too."""
CHECKOUT = Path(__file__).resolve().parents[1]
"""The folder that holds policies, migrations and the built console beside the packages."""


class Settings(BaseSettings):
    """Each field is the environment variable DOWNRANGE_ + its name in capitals."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, extra="forbid", frozen=True, populate_by_name=True
    )

    data_dir: Path = Path("data")
    """Database, throw logs, machine secrets, lock file."""
    database_url: SecretStr | None = None
    """`postgresql://user:password@host/name`; SQLite in the data folder if not set."""
    database_upgrade: bool = False
    """Upgrade an older database at start (the demo does); else that is refused."""
    host: str = "127.0.0.1"
    port_count: int = Field(default=8000, ge=0, le=65535, alias="DOWNRANGE_PORT")
    origins: Annotated[tuple[str, ...], NoDecode] = ()
    """Exact origins of browsers, comma separated; this host's own when empty."""
    secure_cookie: bool = False
    """Send the session cookie over HTTPS only; set it wherever a TLS proxy stands in front."""
    site: str = Field(default="yard", pattern=r"^[a-z0-9][a-z0-9-]{0,31}$")
    link_listen: str = "tcp/127.0.0.1:7447"
    """Zenoh endpoint at which machines call in: `tcp/...` on this computer, `tls/...` over a network."""
    link_certificate: Path | None = None
    """Certificate of a `tls/...` endpoint, PEM; machines get its authority as `--root-ca-file`."""
    link_private_key: Path | None = None
    """Its private key, PEM."""
    link_root_ca: Path | None = None
    """Authority of that certificate, PEM: new machines are given it."""
    link_address: str | None = Field(default=None, pattern=r"^(tcp|tls)/[^/]+:\d{1,5}$")
    """Endpoint as machines reach it, where that is not `link_listen` or the console's own host name."""
    machine_slot_count: int = Field(default=16, ge=0, le=1000)
    """Machine accounts m001.. made at first start; further ones are made as machines are added."""
    policies_dir: Path = CHECKOUT / "policies"
    policy_four_eyes: bool = False
    """Whoever uploaded a policy version may not approve it."""
    zones_four_eyes: bool | None = None
    """Whoever drew exclusion zones may not approve them; None: where several accounts may approve."""
    web_dir: Path = CHECKOUT / "web" / "dist"
    preview_worker_count: int = Field(default=2, ge=1, le=16)
    view_shadows: bool = True
    """Shadows in the 3D view; without them a browser without graphics hardware draws twice as fast."""
    campaign_process_count: int = Field(default=1, ge=1, le=256)
    """Processes that throw in validations, at low priority; one leaves a small computer to the console."""
    campaign_scheduler: str | None = None
    """Dask scheduler, `tcp://HOST:8786`, whose workers throw in validations instead."""
    session_s: float = Field(default=12 * 3600.0, gt=0.0)
    lease_ttl_s: float = Field(default=15.0, gt=0.0)
    lease_idle_s: float = Field(default=600.0, gt=0.0)
    plan_ttl_s: float = Field(default=300.0, gt=0.0)
    trusted_proxies: Annotated[tuple[str, ...], NoDecode] = ()
    """Addresses or networks of reverse proxies, comma separated. Only their X-Forwarded-* headers count."""
    metrics_token: SecretStr | None = None
    """Bearer token with which Prometheus reads /metrics; without it a signed-in auditor may."""
    telematics_token: SecretStr | None = None
    """Bearer token with which other systems read the fleet by ISO 15143-3; a signed-in person may, too."""
    webhook_private: bool = False
    """Allow webhooks to addresses inside a network, and http; else they could reach what only we reach."""
    smtp_url: SecretStr | None = None
    """`smtp://user:password@host:587` (STARTTLS) or `smtps://...`: opened alerts are mailed through it."""
    mail_from: str = Field(default="", max_length=200)
    mail_to: Annotated[tuple[str, ...], NoDecode] = ()
    """Addresses that opened alerts are mailed to, comma separated."""
    drift_diagnoses: bool = False
    """A drift is diagnosed by itself once 12 throws since the change have a log; else a person starts it."""
    min_free_bytes: int = Field(default=256 * 1024 * 1024, ge=0)
    """Free space in the data folder below which /health reports a full disk."""
    log_max_bytes: int = Field(default=64 * 1024 * 1024, ge=1024)
    """Largest throw log that a machine may upload."""

    @field_validator("origins", "trusted_proxies", "mail_to", mode="before")
    @classmethod
    def _split(cls, value: object) -> object:
        if isinstance(value, str):
            return tuple(part.strip().rstrip("/") for part in value.split(",") if part.strip())
        return value

    @field_validator("trusted_proxies")
    @classmethod
    def _are_networks(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for text in value:
            ipaddress.ip_network(text, strict=False)  # its ValueError names the text
        return value

    @model_validator(mode="after")
    def _has_certificate(self) -> "Settings":
        given = self.link_certificate is not None and self.link_private_key is not None
        if given != self.link_listen.startswith("tls/"):
            raise ValueError(
                f"link_listen is {self.link_listen}: a tls/... endpoint needs link_certificate and "
                "link_private_key, and no other endpoint uses them"
            )
        return self

    @model_validator(mode="after")
    def _has_mail_addresses(self) -> "Settings":
        url = self.smtp_url
        if url is not None and not url.get_secret_value().startswith(("smtp://", "smtps://")):
            raise ValueError("smtp_url begins with smtp:// or smtps://")
        if (url is not None) != self.has_mail:
            raise ValueError("e-mail needs all of smtp_url, mail_from and mail_to, or none")
        return self

    @property
    def has_mail(self) -> bool:
        """Whether opened alerts are mailed."""
        return self.smtp_url is not None and bool(self.mail_from) and bool(self.mail_to)

    @property
    def is_link_in_the_clear(self) -> bool:
        """Whether the link leaves this computer without encryption."""
        local = ("tcp/127.", "tcp/localhost:", "tcp/[::1]:")
        return not self.link_listen.startswith(("tls/", *local))

    @property
    def resolved_database_url(self) -> str:
        """The database's URL with its driver."""
        if self.database_url is None:
            return f"sqlite:///{(self.data_dir / 'downrange.db').resolve()}"
        url = self.database_url.get_secret_value()
        for prefix in ("postgresql://", "postgres://"):
            if url.startswith(prefix):
                return "postgresql+psycopg://" + url.removeprefix(prefix)
        return url

    @property
    def allowed_origins(self) -> frozenset[str]:
        """Origins from which a browser may write."""
        if self.origins:
            return frozenset(self.origins)
        hosts = {"127.0.0.1", "localhost"}
        if self.host not in ("0.0.0.0", "::", ""):
            hosts.add(f"[{self.host}]" if ":" in self.host else self.host)
        return frozenset(f"http://{host}:{self.port_count}" for host in hosts)

    def lines(self) -> list[str]:
        """The settings for people, secrets hidden."""
        return [f"{variable_name(name)}={getattr(self, name)}" for name in type(self).model_fields]


def variable_name(field: str) -> str:
    """The environment variable of a field."""
    return Settings.model_fields[field].alias or PREFIX + field.upper()


def load_settings(environment: Mapping[str, str] | None = None, **overrides: Any) -> Settings:
    """Read the settings.

    Args:
        environment: where the variables are looked for when checking their names; the process's.
        overrides: fields that the command line sets.

    Raises:
        UsageError: an unknown variable DOWNRANGE_*, or an invalid value.
    """
    found = os.environ if environment is None else environment
    known = {variable_name(name) for name in Settings.model_fields}
    unknown = sorted(
        name for name in found if name.startswith(PREFIX) and name not in known | CLIENT_VARIABLES
    )
    if unknown:
        raise UsageError(
            f"unknown setting {', '.join(unknown)}; known are {', '.join(sorted(known))}"
        )
    values = {
        Settings.model_fields[name].alias or name: value
        for name, value in overrides.items()
        if value is not None
    }
    try:
        return Settings(**values)
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(str(part) for part in item['loc'])}: {item['msg']}"
            for item in error.errors()
        )
        raise UsageError(f"settings cannot be used: {problems}") from error
