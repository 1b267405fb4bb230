"""Lists of names in a sentence."""

from collections.abc import Sequence


def shortened(names: Sequence[str], most: int) -> str:
    """Return names with commas between them, and dots for those beyond `most`."""
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")
