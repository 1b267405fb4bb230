"""A `Dae` as bytes: CasADi's expressions once, all together, and the rest around them."""

import io
import pickle
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae


class _Pickler(pickle.Pickler):
    """Leaves expressions out and numbers them; symbols stay the same symbols only together."""

    def __init__(self, stream: io.BytesIO) -> None:
        super().__init__(stream)
        self.expressions: list[SX] = []

    def persistent_id(self, obj: Any) -> int | None:
        if not isinstance(obj, SX):
            return None
        self.expressions.append(obj)
        return len(self.expressions) - 1


class _Unpickler(pickle.Unpickler):
    def __init__(self, stream: io.BytesIO, expressions: list[SX]) -> None:
        super().__init__(stream)
        self.expressions = expressions

    def persistent_load(self, pid: Any) -> SX:
        found: SX = self.expressions[pid]
        return found


def dae_to_bytes(dae: Dae) -> bytes:
    """Return a `Dae` as bytes that another process with the same CasADi can read."""
    stream = io.BytesIO()
    pickler = _Pickler(stream)
    pickler.dump(dae)
    serializer = ca.StringSerializer()
    serializer.pack(pickler.expressions)
    return pickle.dumps((serializer.encode(), stream.getvalue()))


def dae_from_bytes(content: bytes) -> Dae:
    """Return the `Dae` of `dae_to_bytes`. Only for bytes that this program wrote."""
    expressions, rest = pickle.loads(content)
    found: Dae = _Unpickler(io.BytesIO(rest), ca.StringDeserializer(expressions).unpack()).load()
    return found
