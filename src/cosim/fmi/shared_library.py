"""Shared libraries as files: processor, what they export and need, and fat ones.

Libraries of other platforms cannot be loaded here, and those of strangers should not be.

References:
    System V ABI, Object Files; Microsoft, PE Format; Apple, mach-o/loader.h and mach-o/fat.h.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

_ELF_PROCESSORS = {0x3E: "x86_64", 0xB7: "aarch64", 0x03: "x86"}
_PE_PROCESSORS = {0x8664: "x86_64", 0xAA64: "aarch64", 0x14C: "x86"}
_MACH_PROCESSORS = {0x01000007: "x86_64", 0x0100000C: "aarch64"}
_FAT_ALIGNMENT = 14  # 2^14 bytes, the largest page of any processor
_DYNAMIC_SYMBOLS = 11  # SHT_DYNSYM
_DYNAMIC, _VERSIONS = 6, 0x6FFFFFFE  # SHT_DYNAMIC, SHT_GNU_verneed
_NEEDED, _RPATH, _RUNPATH = 1, 15, 29  # DT_*
_SYMBOL_VERSIONS, _GLOBAL = 0x6FFFFFFF, 1  # SHT_GNU_versym, STB_GLOBAL
_SYMBOL_TABLE = 2  # LC_SYMTAB
_LOADS = (0x0C, 0x80000018, 0x8000001F)  # LC_LOAD_DYLIB, LC_LOAD_WEAK_DYLIB, LC_REEXPORT_DYLIB
_MACH_RPATH, _OLD_MINIMUM, _BUILD = 0x8000001C, 0x24, 0x32  # LC_RPATH, LC_VERSION_MIN_MACOSX, ...
_IMPORTS, _DELAYED = 1, 13  # directories of a PE file


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
    """
    try:
        if content[:4] == b"\x7fELF":
            return (_elf(content),)
        if content[:2] == b"MZ":
            return (_pe(content),)
        if content[:4] == b"\xca\xfe\xba\xbe":
            (count,) = struct.unpack_from(">I", content, 4)
            places = [struct.unpack_from(">5I", content, 8 + 20 * i) for i in range(count)]
            return tuple(_mach(content[start : start + size]) for _, _, start, size, _ in places)
        if content[:4] == b"\xcf\xfa\xed\xfe":
            return (_mach(content),)
    except (struct.error, IndexError, KeyError, StopIteration) as error:
        raise ValueError(f"it is damaged or for an unknown processor ({error!r})") from error
    raise ValueError("it is no shared library for Linux, Windows or macOS")


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


def _c_string(content: bytes, start: int) -> str:
    end = content.find(b"\0", start)
    if end < 0:
        raise IndexError(start)
    return content[start:end].decode("ascii", "replace")


def _elf(content: bytes) -> Library:  # noqa: C901  # one pass over a binary format
    if content[4:6] != b"\x02\x01":
        raise ValueError("it is not a 64-bit little-endian library")
    (kind, machine) = struct.unpack_from("<HH", content, 16)
    if kind != 3:
        raise ValueError("it is not a shared library")
    (headers,) = struct.unpack_from("<Q", content, 0x28)
    (size, count) = struct.unpack_from("<HH", content, 0x3A)
    sections = [
        struct.unpack_from("<IIQQQQIIQQ", content, headers + size * i) for i in range(count)
    ]
    symbols = next(s for s in sections if s[1] == _DYNAMIC_SYMBOLS)
    names = sections[symbols[6]][4]

    def exports() -> Iterator[str]:
        for place in range(symbols[4], symbols[4] + symbols[5], 24):
            name, info, _, section = struct.unpack_from("<IBBH", content, place)
            if section and info >> 4:  # defined here, not local
                yield _c_string(content, names + name)

    def undefined() -> Iterator[str]:
        marks = next((s[4] for s in sections if s[1] == _SYMBOL_VERSIONS), None)
        for i in range(1, symbols[5] // 24):
            name, info, _, section = struct.unpack_from("<IBBH", content, symbols[4] + 24 * i)
            (mark,) = (0,) if marks is None else struct.unpack_from("<H", content, marks + 2 * i)
            if not section and info >> 4 == _GLOBAL and mark & 0x7FFF < 2:
                yield _c_string(content, names + name)

    def entries() -> Iterator[tuple[int, str]]:
        for section in (s for s in sections if s[1] == _DYNAMIC):
            for place in range(section[4], section[4] + section[5], 16):
                tag, value = struct.unpack_from("<QQ", content, place)
                if tag in (_NEEDED, _RPATH, _RUNPATH):
                    yield tag, _c_string(content, sections[section[6]][4] + value)

    def versions() -> Iterator[str]:
        for section in (s for s in sections if s[1] == _VERSIONS):
            place = section[4]
            for _ in range(section[7]):  # as many libraries
                _, count, _, first, following = struct.unpack_from("<HHIII", content, place)
                inner = place + first
                for _ in range(count):
                    _, _, _, name, step = struct.unpack_from("<IHHII", content, inner)
                    yield _c_string(content, sections[section[6]][4] + name)
                    inner += step
                place += following

    dynamic = tuple(entries())
    return Library(
        "linux",
        _ELF_PROCESSORS[machine],
        frozenset(exports()),
        frozenset(name for tag, name in dynamic if tag == _NEEDED),
        frozenset(versions()),
        tuple(p for tag, text in dynamic if tag != _NEEDED for p in text.split(":") if p),
        frozenset(undefined()),
    )


def _pe(content: bytes) -> Library:
    (start,) = struct.unpack_from("<I", content, 0x3C)
    if content[start : start + 4] != b"PE\0\0":
        raise ValueError("it is not a Windows library")
    machine, count = struct.unpack_from("<HH", content, start + 4)
    (optional,) = struct.unpack_from("<H", content, start + 20)
    (magic,) = struct.unpack_from("<H", content, start + 24)
    directories = start + 24 + (112 if magic == 0x20B else 96)
    (amount,) = struct.unpack_from("<I", content, directories - 4)
    headers = start + 24 + optional
    sections = [struct.unpack_from("<4I", content, headers + 40 * i + 8) for i in range(count)]

    def place(address: int) -> int:
        for size, virtual, raw_size, raw in sections:
            if virtual <= address < virtual + max(size, raw_size):
                return int(address - virtual + raw)
        raise IndexError(address)

    def directory(index: int) -> int:
        if index >= amount:
            return 0
        return int(struct.unpack_from("<I", content, directories + 8 * index)[0])

    def needs(index: int, size: int, name: int) -> Iterator[str]:
        address = directory(index)
        entry = place(address) if address else 0
        while address and (offset := struct.unpack_from("<I", content, entry + name)[0]):
            yield _c_string(content, place(offset))
            entry += size

    exports: frozenset[str] = frozenset()
    if address := directory(0):
        named, _, names = struct.unpack_from("<3I", content, place(address) + 24)
        table = struct.unpack_from(f"<{named}I", content, place(names) if named else 0)
        exports = frozenset(_c_string(content, place(one)) for one in table)
    loaded = frozenset((*needs(_IMPORTS, 20, 12), *needs(_DELAYED, 32, 4)))
    return Library("windows", _PE_PROCESSORS[machine], exports, loaded)


def _mach(content: bytes) -> Library:
    _, processor, _, kind, count, _ = struct.unpack_from("<6I", content)
    if kind != 6:
        raise ValueError("it is not a shared library")
    exports: set[str] = set()
    needs: set[str] = set()
    versions: set[str] = set()
    run_paths: list[str] = []
    place = 32
    for _ in range(count):
        command, size = struct.unpack_from("<2I", content, place)
        if not size:
            raise IndexError(place)
        if command == _SYMBOL_TABLE:
            symbols, amount, names, _ = struct.unpack_from("<4I", content, place + 8)
            for i in range(amount):
                name, flags, _, _, _ = struct.unpack_from("<IBBHQ", content, symbols + 16 * i)
                # external, not private to the library, defined in a section
                if flags & 0x1F == 0x0F:
                    exports.add(_c_string(content, names + name).removeprefix("_"))
        elif command in (*_LOADS, _MACH_RPATH):
            (text,) = struct.unpack_from("<I", content, place + 8)
            loaded = _c_string(content, place + text)
            needs.update({loaded} if command != _MACH_RPATH else ())
            run_paths += [loaded] if command == _MACH_RPATH else []
        elif command in (_OLD_MINIMUM, _BUILD):
            (least,) = struct.unpack_from("<I", content, place + (12 if command == _BUILD else 8))
            versions.add(f"macOS_{least >> 16}.{least >> 8 & 0xFF}")
        place += size
    return Library(
        "darwin",
        _MACH_PROCESSORS[processor],
        frozenset(exports),
        frozenset(needs),
        frozenset(versions),
        tuple(run_paths),
    )
