"""An FMU with its proof, taken from the cache where the very same one was made before."""

import hashlib
import os
import pickle
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

from casadi_models.dae import Dae
from cosim.codegen.cache import content_of, keep
from cosim.errors import CacheError
from cosim.files import refuse_unwritable, write_atomically
from cosim.verify.made_with import made_with


def export_kept(
    dae: Dae, target: str | os.PathLike[str], *, reference: bool = True, **options: Any
) -> tuple[Path, str | None]:
    """Write what `export_with_proof` does, from the cache if it is there: the same bytes.

    What was exported with a warning is not kept: it is said each time.

    Args:
        dae, target, reference, options: See `export_with_proof`.

    Returns:
        Path of the FMU, and the name of what the cache keeps of it; None where it keeps nothing.

    Raises:
        CosimError: See `export_with_proof`.

    Warns:
        UserWarning: See `export_with_proof`.
    """
    refuse_unwritable(target)
    entry = f"exports/{export_key(dae, reference=reference, **options)}"
    if (content := content_of(entry)) is not None:
        from cosim.fmi.trust import remember

        remember(content)
        return write_atomically(target, content), entry
    from cosim.verify.reference_result import export_with_proof  # takes its time

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        path = export_with_proof(dae, target, reference=reference, **options)
    for one in said:
        warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
    if not said:
        with suppress(OSError, CacheError):
            keep(entry, path.read_bytes())
            return path, entry
    return path, None


def export_key(dae: Dae, **options: Any) -> str:
    """Return a hash of all that an exported file depends on: model, options, tools, this code."""
    parts = (pickle.dumps(dae, protocol=5), repr(sorted(options.items())), made_with())
    return hashlib.sha256(repr(parts).encode()).hexdigest()
