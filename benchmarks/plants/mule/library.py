"""Load the plant's C code, compiled once a version of the source into ``build/plants``."""

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

SOURCE = Path(__file__).with_name("mule.c")
BUILD = Path(__file__).parents[3] / "build" / "plants"
_POINTER, _INT, _DOUBLE, _LONG = ctypes.c_void_p, ctypes.c_int, ctypes.c_double, ctypes.c_int64


def compiled_file() -> Path:
    """Where the compiled code of this source lies; copy it along to computers without a compiler."""
    digest = hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:16]
    return BUILD / f"mule-{digest}-{os.uname().machine}.so"


def load_mule() -> ctypes.CDLL:
    """The compiled plant.

    Raises:
        RuntimeError: it is not compiled and there is no C compiler.
        subprocess.CalledProcessError: the source does not compile.
    """
    target = compiled_file()
    if not target.exists():
        _compile(target)
    library = ctypes.CDLL(str(target))
    library.mule_parameter_names.restype = ctypes.c_char_p
    library.mule_new.restype = _POINTER
    library.mule_new.argtypes = [_INT]
    library.mule_free.argtypes = [_POINTER]
    library.mule_configure.argtypes = [_POINTER, _INT, _POINTER]
    library.mule_reset.argtypes = [_POINTER, _INT, _POINTER, ctypes.c_uint64, _LONG]
    library.mule_reload.argtypes = [_POINTER, _INT]
    library.mule_set.argtypes = [_POINTER, _INT, _DOUBLE, _INT]
    library.mule_advance.argtypes = [_POINTER, _INT, _POINTER, _POINTER, _LONG, _INT]
    library.mule_read.argtypes = [_POINTER, _INT, _POINTER]
    library.mule_mass.argtypes = [_POINTER, _INT, _POINTER, _POINTER]
    return library


def _compile(target: Path) -> None:
    """Compile beside the target, then rename: several processes may do this at once."""
    names = [os.environ.get("CC"), "cc", "gcc", "clang"]
    compiler = next((path for name in names if name and (path := shutil.which(name))), None)
    if compiler is None:
        raise RuntimeError(f"no C compiler: install one, or copy {target} from a computer with one")
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        made = Path(folder) / target.name
        flags = ["-O3", "-std=gnu11", "-Wall", "-Wextra", "-shared", "-fPIC"]
        subprocess.run([compiler, *flags, "-o", str(made), str(SOURCE), "-lm"], check=True)
        made.replace(target)
