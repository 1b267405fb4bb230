"""An export in the words of an earlier one: its file from the cache, and nothing else loaded.

Words tell what is made only where they name a model of the catalogue or a shipped scene: the code
of those is known, and nothing outside it has a say.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from cosim.codegen.cache import content_of, keep
from cosim.errors import CacheError
from cosim.files import write_atomically
from cosim.verify.made_with import made_with


@dataclass(frozen=True)
class ExportNote:
    """What is told of an export.

    Attributes:
        entry: What the cache keeps of its file.
        name: Of the file where its user gives none, without suffix.
        model: `MODEL/FORMULATION`.
        report: What the reduction says.
        inputs: That the importer has to supply series of.
    """

    entry: str
    name: str
    model: str
    report: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()


def words_tell_all(model: str) -> bool:
    """Tell whether a model's or a scene's name alone says what it is: nobody's file has a say.

    Example:
        >>> from cosim.verify.repeated_export import words_tell_all
        >>> [words_tell_all(name) for name in ("bicycle", "bicycle_path.toml", "my.py:build")]
        [True, True, False]
    """
    if model.endswith(".toml"):
        return len(Path(model).parts) == 1 and not os.path.lexists(model)
    return "." not in model


def repeat_export(
    words: Mapping[str, object], target: str | os.PathLike[str] | None
) -> tuple[Path, ExportNote] | None:
    """Write the file of an export in the same words; None where the cache has none.

    Args:
        words: The options, `model` among them; see `words_tell_all`.
        target: The file; named as the first one would have been when None.

    Raises:
        ExportError: It cannot be written.
    """
    told = content_of(_entry(words))
    if told is None:
        return None
    facts = json.loads(told)
    facts |= {name: tuple(facts[name]) for name in ("report", "inputs")}
    note = ExportNote(**facts)
    if (content := content_of(note.entry)) is None:
        return None
    from cosim.fmi.trust import remember

    remember(content)
    return write_atomically(f"{note.name}.fmu" if target is None else target, content), note


def note_export(words: Mapping[str, object], note: ExportNote) -> None:
    """Keep what is told of an export, for the next one in the same words."""
    with suppress(OSError, CacheError):
        keep(_entry(words), json.dumps(asdict(note)).encode())


def _entry(words: Mapping[str, object]) -> str:
    parts = (repr(sorted(words.items())), made_with())
    return f"exports/words-{hashlib.sha256(repr(parts).encode()).hexdigest()}"
