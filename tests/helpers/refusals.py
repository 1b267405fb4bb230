"""Calls that must be rejected, and the names of such cases."""

import pytest

from cosim.errors import CosimError


def short(value):
    """Return the name of a case: the same in every process."""
    return repr(value)[:20]


def refusal(kind, call):
    """Return the message of the error that a call raises: one line of bounded length."""
    with pytest.raises(kind) as caught:
        call()
    assert isinstance(caught.value, CosimError)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400
    return message
