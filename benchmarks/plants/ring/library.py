"""Compile and load the plant's C code."""

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

SOURCE = Path(__file__).with_name("ring.c")
BUILD = Path(__file__).parents[3] / "build" / "plants"
_POINTER, _INT, _DOUBLE = ctypes.c_void_p, ctypes.c_int, ctypes.c_double


class NoCompilerError(RuntimeError):
    """No C compiler is installed."""


def find_compiler() -> str | None:
    """Path of the C compiler: ``$CC``, cc, gcc or clang; None where there is none."""
    names = [os.environ.get("CC"), "cc", "gcc", "clang"]
    return next((path for name in names if name and (path := shutil.which(name))), None)


def load_library() -> ctypes.CDLL:
    """The compiled plant; compiled at most once a version of the source.

    Raises:
        NoCompilerError: there is no C compiler.
        subprocess.CalledProcessError: the source does not compile.
    """
    digest = hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:16]
    target = BUILD / f"ring-{digest}-{os.uname().machine}.so"
    if not target.exists():
        _compile(target)
    library = ctypes.CDLL(str(target))
    library.ring_parameter_names.restype = ctypes.c_char_p
    library.ring_new.restype = _POINTER
    library.ring_new.argtypes = [_INT]
    library.ring_free.argtypes = [_POINTER]
    library.ring_configure.argtypes = [_POINTER, _INT, _POINTER]
    library.ring_reset.argtypes = [_POINTER, _INT, _POINTER, ctypes.c_uint64, _DOUBLE]
    library.ring_reload.argtypes = [_POINTER, _INT]
    library.ring_set.argtypes = [_POINTER, _INT, _DOUBLE, _INT]
    library.ring_advance.argtypes = [_POINTER, _INT, _POINTER, _POINTER, _DOUBLE, _INT]
    library.ring_read.argtypes = [_POINTER, _INT, _POINTER]
    library.ring_mass.argtypes = [_POINTER, _INT, _POINTER, _POINTER]
    return library


def _compile(target: Path) -> None:
    """Compile into a temporary file beside the target, then rename: several processes may do this at once."""
    compiler = find_compiler()
    if compiler is None:
        raise NoCompilerError(
            "the plant `ring` is C code: install a C compiler (gcc or clang) or set CC to one"
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        made = Path(folder) / target.name
        flags = ["-O3", "-std=c11", "-Wall", "-Wextra", "-shared", "-fPIC"]
        command = [compiler, *flags, "-o", str(made), str(SOURCE), "-lm"]
        subprocess.run(command, check=True)
        made.replace(target)
