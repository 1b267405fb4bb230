"""The processor instructions of a compiled library, read by a disassembler."""

import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import pytest

needs_objdump = pytest.mark.skipif(
    shutil.which("objdump") is None, reason="needs objdump: apt install binutils"
)
FUSED = re.compile(r"v4?fn?m(?:add|sub)\w*")  # vfmadd132sd, vfmaddsub231pd, vfnmsub213sd, ...

# Beyond SSE2, which every x86-64 has: by the registers, by the encoding (v...), by name. `tzcnt` is
# how `rep bsf` is shown, which every processor runs.
_REGISTERS = re.compile(r"%(?:[yz]mm\d+|xmm(?:1[6-9]|2\d|3[01])|k[0-7]|r(?:1[6-9]|2\d|3[01])\b)")
_NAMES = re.compile(
    r"v(?!err|erw)\w+|addsubp[sd]|h(?:add|sub)p[sd]|lddqu|mov(?:d|sh|sl)dup|fisttp\w*|pshufb|"
    r"palignr|pabs[bwd]|psign[bwd]|ph(?:add|sub)\w+|pmaddubsw|pmulhrsw|p?blend\w+|dpp[sd]|"
    r"(?:extract|insert)ps|p(?:extr|insr)[bdq]|mpsadbw|packusdw|p(?:cmpeq|cmpgt)q|"
    r"p(?:max|min)(?:sb|sd|ud|uw)|pmov[sz]x\w+|pmul(?:dq|ld)|ptest|round[ps][sd]|"
    r"pcmp[ei]str\w+|crc32\w*|popcnt\w*|lzcnt\w*|andn|bextr\w*|bls(?:i|r|msk)\w*|bzhi\w*|mulx\w*|"
    r"p(?:dep|ext)[lq]?|rorx\w*|s[ah][lr]x\w*|ad[co]x\w*|movbe\w*|aes\w+|pclmul\w+|sha(?:1|256)\w+|"
    r"rd(?:rand|seed)\w*|movntdqa"
)


def fused(library: Path) -> Counter[str]:
    """Count the instructions that round a product and a sum once."""
    return Counter(name for name, _ in _disassembled(library) if FUSED.fullmatch(name))


def beyond_baseline(library: Path) -> Counter[str]:
    """Count the instructions that not every x86-64 has."""
    return Counter(
        name
        for name, operands in _disassembled(library)
        if _REGISTERS.search(operands) or _NAMES.fullmatch(name)
    )


def _disassembled(library: Path) -> list[tuple[str, str]]:
    call = ["objdump", "-d", "--no-show-raw-insn", str(library)]
    text = subprocess.run(call, check=True, capture_output=True, text=True).stdout
    found = re.findall(r"^\s+[0-9a-f]+:\t(?:\{\w+\} )?(\S+)(.*)$", text, re.MULTILINE)
    assert len(found) > 10, f"objdump shows nothing of {library}"
    return found
