"""Entry point `downrange`: find the verb, import its module only, print errors as one line."""

import importlib
import sys
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import NamedTuple

import tyro

from machine.errors import DownrangeError


class Verb(NamedTuple):
    """A verb of the command line."""

    module: str
    summary: str
    extra: str = ""
    """The optional dependencies it needs, as in ``uv sync --extra NAME``."""


VERBS: dict[str, Verb] = {
    "demo": Verb(
        "cli.service.demo", "run server, virtual machine and console on one port", "server"
    ),
    "server": Verb("cli.service.server", "run the web service", "server"),
    "machine": Verb("cli.machine", "run on a machine's computer, or stand in for one"),
    "rollback": Verb(
        "cli.service.rollback", "put a machine back on its policy version before, at the machine"
    ),
    "policy": Verb("cli.service.policy", "show policy versions, deploy them, roll back", "server"),
    "throw": Verb("cli.service.throw", "throw once through a running server", "server"),
    "dossier": Verb(
        "cli.service.dossier",
        "export throws with all that belongs to them, signed; verify it",
        "server",
    ),
    "preview": Verb("cli.preview", "predict one throw in the twin", "twin"),
    "evaluate": Verb(
        "cli.evaluate", "measure accuracy over many throws, by the paper's protocol", "twin"
    ),
    "units": Verb("cli.units", "measure accuracy on machines outside training", "twin"),
    "job": Verb("cli.job", "plan, simulate and report a job with bulk material", "twin"),
    "record": Verb("cli.record", "write the throw logs of a campaign", "twin"),
    "diagnose": Verb(
        "cli.diagnose",
        "locate the sim-to-real gap and name its cause",
        "twin",
    ),
    "challenge": Verb("cli.challenge", "make, run and score a blind check of diagnose", "twin"),
    "commission": Verb(
        "cli.commissioning.verb",
        "measure a machine in one go: twin, registration, baseline",
        "twin",
    ),
    "calibrate": Verb("cli.calibrate", "measure valves, response and registration", "twin"),
    "identify": Verb(
        "cli.identify", "find response, release delay and swing of a machine from its logs", "twin"
    ),
    "train": Verb("cli.train", "train a policy", "train"),
    "user": Verb("cli.service.user", "say who may sign in to the console, and as what", "server"),
    "router": Verb("cli.service.router", "run a further router for machines", "server"),
    "db": Verb("cli.service.db", "upgrade, downgrade or check the database", "server"),
    "openapi": Verb("cli.service.openapi", "write the description of the HTTP interface", "server"),
    "spec": Verb("cli.spec", "write machine/spec.json from the MJCF", "twin"),
}


def _overview() -> str:
    width = max(map(len, VERBS))
    verbs = "\n".join(f"  {name:<{width}}  {verb.summary}" for name, verb in VERBS.items())
    return f"""usage: downrange VERB [OPTIONS]

Throw with a material handler. Verbs:

{verbs}

`downrange VERB --help` explains a verb."""


def _run(module: ModuleType, prog: str, arguments: Sequence[str]) -> int | None:
    """Call what the verb's module offers: one of its ``ACTIONS`` by name, else ``run``."""
    actions: dict[str, Callable[..., int]] | None = getattr(module, "ACTIONS", None)
    has_both = hasattr(module, "run") and not (arguments and arguments[0] in (actions or {}))
    if actions is None or has_both:
        return tyro.cli(module.run, prog=prog, args=arguments)
    return tyro.extras.subcommand_cli_from_dict(actions, prog=prog, args=arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the process's exit code."""
    argv = list(sys.argv[1:] if arguments is None else arguments)
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(_overview())
        return 0
    verb = VERBS.get(argv[0])
    if verb is None:
        print(f"downrange: no verb '{argv[0]}'\n\n{_overview()}", file=sys.stderr)
        return 1
    try:
        module = importlib.import_module(verb.module)
    except ModuleNotFoundError as error:
        if not verb.extra or (error.name or "").split(".")[0] in ("cli", "machine"):
            raise
        print(
            f"downrange {argv[0]}: the package '{error.name}' is not installed; "
            f"run `uv sync --extra {verb.extra}` or `make setup`",
            file=sys.stderr,
        )
        return 1
    try:
        code = _run(module, f"downrange {argv[0]}", argv[1:])
    except DownrangeError as error:
        print(f"downrange {argv[0]}: {error}", file=sys.stderr)
        return 1
    except SystemExit as end:
        # Wrong options end with 2, which is the exit code of an ambiguous diagnosis.
        raise SystemExit(1 if end.code == 2 else end.code) from None
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130
    return int(code or 0)


if __name__ == "__main__":
    raise SystemExit(main())
