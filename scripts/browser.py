"""Find a Chromium for the browser tests; install it with apt-get where that is possible."""

import os
import shutil
import subprocess
import sys

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def main() -> int:
    """Print the path of the browser, or how to install one."""
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None and shutil.which("apt-get") and os.geteuid() == 0:
        print("== installing Chromium for the browser tests (apt-get install chromium)")
        quiet = {
            "stdout": subprocess.DEVNULL,
            "env": {**os.environ, "DEBIAN_FRONTEND": "noninteractive"},
        }
        subprocess.run(["apt-get", "update", "-qq"], check=False, **quiet)
        subprocess.run(["apt-get", "install", "-y", "-qq", "chromium"], check=False, **quiet)
        found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None:
        print(
            "No Chromium found: the browser tests need one. Install it (Debian: apt-get install chromium) "
            "and run `make test` again.",
            file=sys.stderr,
        )
        return 1
    print(f"== browser: {found}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
