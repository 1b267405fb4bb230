"""`recorded_errors`: what a thread writes to standard error."""

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock, get_ident
from typing import Any, TextIO, cast

_LOCK = Lock()


class _Recorder:
    """Standard error while threads record what they write; all others reach the usual stream."""

    def __init__(self, usual: Any) -> None:
        self.usual = usual
        self.texts = dict[int, io.StringIO]()

    def write(self, text: str) -> int:
        stream = self.texts.get(get_ident(), self.usual)
        return len(text) if stream is None else int(stream.write(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.usual, name)


@contextmanager
def recorded_errors() -> Iterator[io.StringIO]:
    """Record what this thread writes to `sys.stderr` meanwhile, as CasADi does for SUNDIALS."""
    own, thread = io.StringIO(), get_ident()
    with _LOCK:
        recorder: Any = sys.stderr
        if not isinstance(recorder, _Recorder):
            recorder = _Recorder(sys.stderr)
            sys.stderr = cast(TextIO, recorder)
        usual, outer = recorder.usual, recorder.texts.get(thread)
        recorder.texts[thread] = own
    try:
        yield own
    finally:
        with _LOCK:
            if outer is not None:
                recorder.texts[thread] = outer
            else:
                del recorder.texts[thread]
            if not recorder.texts and sys.stderr is recorder:
                sys.stderr = usual
