"""Names of models as C identifiers and file names."""

import re

from cosim.errors import ExportError

_C_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,99}")
# C11 keywords, then names that Windows keeps for devices
_RESERVED = (
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while main "
    "con prn aux nul com1 com2 com3 com4 com5 com6 com7 com8 com9 "
    "lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 lpt9"
)


def model_identifier(name: str) -> str:
    """Return the identifier of `MODEL/FORMULATION`: the slash becomes an underscore.

    Raises:
        ExportError: What results is no C name of at most 100 characters, or a reserved word.
    """
    identifier = name.replace("/", "_", 1)
    if not _C_NAME.fullmatch(identifier):
        raise ExportError(
            f"'{name}' cannot name an FMU: use at most 100 ASCII letters, digits and _, "
            "beginning with a letter or _"
        )
    if identifier.lower() in _RESERVED.split():
        raise ExportError(f"'{name}' cannot name an FMU: it is a reserved word; choose another")
    return identifier
