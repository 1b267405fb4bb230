"""The kernel of events by itself, in C, under the address and the undefined-behavior sanitizers."""

import subprocess
from pathlib import Path

import pytest
from helpers.harness import INCLUDES, SANITIZED, STRICT, compiler

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")


@pytest.mark.slow
def test_the_kernel_steps_without_an_integrator(tmp_path):
    program = tmp_path / "kernel"
    source = Path(__file__).with_name("kernel.c")
    call = [compiler(), *STRICT, *SANITIZED, *INCLUDES, str(source), "-o", str(program), "-lm"]
    subprocess.run(call, check=True)
    done = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert done.stdout == "all right\n", done.stderr
