"""Shared libraries as files: processor, what they export and need, and fat ones.

Libraries of other platforms cannot be loaded here, and those of strangers should not be. LIEF
reads them.
"""

import struct
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cosim.host.optional_packages import optional_module

_FAT_ALIGNMENT = 14  # 2^14 bytes, the largest page of any processor
_PROCESSORS = {"X86_64": "x86_64", "AMD64": "x86_64", "AARCH64": "aarch64", "ARM64": "aarch64"}
_PROCESSORS |= {"I386": "x86"}  # by the names of ELF, PE and Mach-O


@dataclass(frozen=True)
class Library:
    """A shared library for one processor.

    Attributes:
        system: "linux", "windows" or "darwin".
        processor: "x86_64", "aarch64" or "x86".
        exports: Names of the functions and data that a program may look up.
        needs: Libraries that are loaded with it.
        versions: Of what it takes from them, e.g. "GLIBC_2.17", "macOS_11.0".
        run_paths: Folders where the loader looks for them first.
        undefined: Of Linux: names that must come from a library, but not from which version of it.
    """

    system: str
    processor: str
    exports: frozenset[str]
    needs: frozenset[str] = frozenset()
    versions: frozenset[str] = frozenset()
    run_paths: tuple[str, ...] = ()
    undefined: frozenset[str] = frozenset()


def read_libraries(content: bytes) -> tuple[Library, ...]:
    """Return the libraries in a file; more than one in a fat Mach-O file.

    Raises:
        ValueError: It is no shared library of a known kind, or damaged.
        MissingTool: LIEF is not installed.
    """
    lief = optional_module("lief", "check")
    lief.logging.disable()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numbers without a meaning
            parsed: Any = lief.parse(content)
            if isinstance(parsed, lief.ELF.Binary) and parsed.last_offset_section <= len(content):
                return (_elf(parsed, lief.ELF),)
            if isinstance(parsed, lief.PE.Binary):
                return (_pe(parsed),)
            if isinstance(parsed, lief.MachO.Binary):
                every = lief.MachO.parse(content)  # its parts live as long as it does
                return tuple(_mach(one, lief.MachO) for one in every or ())
    except (KeyError, AttributeError, UnicodeError) as error:  # what LIEF leaves as a number
        raise ValueError(f"it is damaged or for an unknown processor ({error!r})") from error
    raise ValueError("it is damaged, or no shared library for Linux, Windows or macOS")


def fat_library(libraries: Sequence[bytes]) -> bytes:
    """Return one Mach-O file of libraries for several processors, as `lipo -create` makes it.

    Raises:
        ValueError: One of them is no Mach-O library.
    """
    page = 1 << _FAT_ALIGNMENT
    header, body = struct.pack(">2I", 0xCAFEBABE, len(libraries)), b""
    for content in libraries:
        if content[:4] != b"\xcf\xfa\xed\xfe":
            raise ValueError("only Mach-O libraries can be put into one file")
        processor, model = struct.unpack_from("<2I", content, 4)
        start = page + len(body)
        header += struct.pack(">5I", processor, model, start, len(content), _FAT_ALIGNMENT)
        body += content + bytes(-len(content) % page)
    return header.ljust(page, b"\0") + body


def _elf(library: Any, elf: Any) -> Library:
    symbols, header = list(library.dynamic_symbols), library.header
    processor = _PROCESSORS[header.machine_type.name]
    whole = len(library.sections) == header.numberof_sections
    if header.file_type != elf.Header.FILE_TYPE.DYN or not (whole and symbols):
        raise ValueError("it is damaged or not a shared library")
    kinds = (elf.DynamicEntryRpath, elf.DynamicEntryRunPath)
    paths = [entry for entry in library.dynamic_entries if isinstance(entry, kinds)]
    needed = library.symbols_version_requirement
    bound = {s.name for s in symbols if s.has_version and s.symbol_version.value > 1}
    bare = [s for s in symbols if not s.shndx and s.name not in bound]
    return Library(
        "linux",
        processor,
        frozenset(str(s.name) for s in symbols if s.exported),
        frozenset(library.libraries),
        frozenset(v.name for one in needed for v in one.get_auxiliary_symbols()),
        tuple(place for entry in paths for place in entry.paths if place),
        frozenset(str(s.name) for s in bare if s.binding == elf.Symbol.BINDING.GLOBAL),
    )


def _pe(library: Any) -> Library:
    if len(library.sections) != library.header.numberof_sections:
        raise ValueError("it is damaged")
    table = library.get_export()
    loaded = [*library.imports, *library.delay_imports]
    return Library(
        "windows",
        _PROCESSORS[library.header.machine.name],
        frozenset(e.name for e in table.entries if e.name) if table else frozenset(),
        frozenset(one.name for one in loaded),
    )


def _mach(library: Any, mach: Any) -> Library:
    commands, kinds = list(library.commands), mach.LoadCommand.TYPE
    whole = len(commands) == library.header.nb_cmds
    if not whole or library.header.file_type != mach.Header.FILE_TYPE.DYLIB:
        raise ValueError("it is damaged or not a shared library")
    least = library.build_version.minos if library.has_build_version else ()
    least = library.version_min.version if library.has_version_min else least
    shown = [s for s in library.symbols if s.raw_type & 0x1F == 0x0F]  # defined, not private
    loaded = [one for one in library.libraries if one.command != kinds.ID_DYLIB]
    return Library(
        "darwin",
        _PROCESSORS[library.header.cpu_type.name],
        frozenset(str(s.name).removeprefix("_") for s in shown),
        frozenset(one.name for one in loaded),
        frozenset({f"macOS_{least[0]}.{least[1]}"} if least else ()),
        tuple(one.path for one in library.rpaths),
    )
