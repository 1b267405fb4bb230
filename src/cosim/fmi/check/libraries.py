"""Where the Linux libraries of an FMU load: what they need, how new a system, which folders."""

import re
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import PurePosixPath

from cosim.fmi.archive import content_of
from cosim.fmi.check.finding import ADVICE, Finding
from cosim.fmi.shared_library import Library, read_libraries

_EVERYWHERE = re.compile(
    r"(libc|libm|libdl|libpthread|librt|libgcc_s|libstdc\+\+|ld-linux[\w-]*)\.so(\.\d+)*"
)
_OLDEST = (2, 31)  # glibc of Debian 11 and Ubuntu 20.04
_GLIBC = re.compile(r"GLIBC_(\d+)\.(\d+)(\.\d+)?")


def library_findings(archive: zipfile.ZipFile) -> Iterator[Finding]:
    """Tell what keeps the Linux libraries of an FMU from loading elsewhere."""
    for name in archive.namelist():
        path = PurePosixPath(name)
        if len(path.parts) != 3 or path.parts[0] != "binaries" or path.suffix != ".so":
            continue
        with suppress(ValueError):  # which the other checks tell
            for library in read_libraries(content_of(archive, name)):
                yield from _elsewhere(archive, path, library)


def _elsewhere(
    archive: zipfile.ZipFile, path: PurePosixPath, library: Library
) -> Iterator[Finding]:
    beside = {PurePosixPath(other).name for other in archive.namelist()}
    foreign = sorted(n for n in library.needs - beside if not _EVERYWHERE.fullmatch(n))
    if foreign:
        yield Finding(
            *(ADVICE, "imports", str(path), f"it loads {', '.join(foreign)}, not in the FMU"),
            "link statically, or put it beside the library",
        )
    found = [m for text in library.versions if (m := _GLIBC.fullmatch(text))]
    newest = max(((int(m[1]), int(m[2])) for m in found), default=(0, 0))
    if newest > _OLDEST:
        yield Finding(
            *(ADVICE, "glibc", str(path), f"it needs glibc {newest[0]}.{newest[1]} or newer"),
            "compile it on an older system, or for glibc 2.17 with zig",
        )
    for folder in library.run_paths:
        if not folder.startswith(("$ORIGIN", "${ORIGIN}")):
            yield Finding(
                *(ADVICE, "run-path", str(path), f"it looks for libraries in {folder}"),
                "link without a run path, or with $ORIGIN",
            )
