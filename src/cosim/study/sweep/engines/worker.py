"""A process of a sweep, asked and answering through pipes."""

import os
import pickle
import sys
from contextlib import suppress
from typing import BinaryIO

from cosim.study.sweep.chunk import compute_chunk


def serve(questions: BinaryIO, answers: BinaryIO) -> None:
    """Take a `Job`, then answer chunks until nobody asks any more."""
    job = pickle.load(questions)
    _send(answers, None)
    while True:
        try:
            first, columns = pickle.load(questions)
        except EOFError:
            return
        try:
            _send(answers, compute_chunk(job, first, columns))
        except Exception as error:
            _send(answers, error)


def _send(answers: BinaryIO, value: object) -> None:
    try:
        content = pickle.dumps(value)
    except Exception:  # an error of somebody else's that cannot be sent
        content = pickle.dumps(RuntimeError(f"{type(value).__name__}: {value}"))
    answers.write(content)
    answers.flush()


def _main() -> None:
    own = os.dup(1)
    os.dup2(2, 1)  # what FMUs print is no answer
    if sys.platform == "win32":
        import msvcrt

        msvcrt.setmode(own, os.O_BINARY)
        msvcrt.setmode(0, os.O_BINARY)
    with suppress(BrokenPipeError), os.fdopen(own, "wb") as answers:  # nobody listens any more
        serve(sys.stdin.buffer, answers)


if __name__ == "__main__":
    _main()
