"""The verbs: each has a file with `run(args)`; its help and its options are in verbs.toml."""

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_TOPICS = ("what", "times", "solver", "output")
Tables = Mapping[str, Any]  # as read from a TOML file


@dataclass(frozen=True)
class Verb:
    """The help of a verb.

    Attributes:
        section: Its section in `cosim --help`.
        summary: One sentence on what it does.
        examples: Two command lines.
        options: Fields of its options by name, in the order of its help; `topic` is the group of
            the help: "what", "times", "solver" or "output".
        exclusive: Names of options of which a command line has one at most.
    """

    section: str
    summary: str
    examples: tuple[str, ...]
    options: Mapping[str, Tables]
    exclusive: tuple[str, ...]


def _read() -> dict[str, Verb]:
    shared, verbs = (
        tomllib.loads(Path(__file__).with_name(name).read_text(encoding="utf-8"))
        for name in ("options.toml", "verbs.toml")
    )
    found, section = {}, ""
    for verb, table in verbs.items():
        section = table.get("section", section)
        names = _single([*table["options"], "common"], shared["sets"])
        options = {name: _option(name, table, shared) for name in names}
        examples, exclusive = (tuple(table.get(key, ())) for key in ("examples", "exclusive"))
        found[verb] = Verb(section, table["summary"], examples, options, exclusive)
    return found


def _single(names: Sequence[str], sets: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """Yield names of options, with the members of sets in place of the sets."""
    for name in names:
        yield from _single(sets[name], sets) if name in sets else (name,)


def _option(name: str, own: Tables, shared: Tables) -> Tables:
    """Return the fields of an option: the shared ones, and those that a verb replaces."""
    topic = next(t for t in _TOPICS if name in own.get(t, ()) or name in shared[t])
    fields = {**shared[topic].get(name, {}), **own.get(topic, {}).get(name, {}), "topic": topic}
    texts = own.get("help", {})
    return fields | {"help": texts[name]} if name in texts else fields


VERBS = _read()

# Other names of verbs, with the words that they stand for
ALIASES = {"list": ("info",), "scene": ("new", "-", "--from")}
