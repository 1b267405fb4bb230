"""The kernel of events by itself, in C."""

import subprocess
from pathlib import Path

import pytest
from helpers.harness import INCLUDES, POSIX, SANITIZED, STRICT, compiler

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")


def printed(name: str, tmp_path: Path, *flags: str) -> str:
    """Return what a C program of this folder prints."""
    program, source = tmp_path / name, Path(__file__).with_name(f"{name}.c")
    more = [*flags, *INCLUDES, str(source), "-o", str(program), "-lm", "-pthread"]
    subprocess.run([compiler(), *STRICT, POSIX, *more], check=True)
    done = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    return done.stdout or done.stderr


@pytest.mark.slow
def test_the_kernel_steps_without_an_integrator(tmp_path):
    assert printed("kernel", tmp_path, *SANITIZED) == "all right\n"


def test_many_relations_slide_in_a_thread_with_a_small_stack(tmp_path):
    assert printed("many_slide", tmp_path) == "all right\n"
