"""The modules of the product and what they import, read from their sources."""

import ast
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = {
    "casadi_models": ROOT / "casadi_models",
    "cosim": ROOT / "src" / "cosim",
    "cosim._fmu": ROOT / "fmu",
}


def modules() -> dict[str, str]:
    """Return the source of every module by its import name."""
    sources = {}
    for package, folder in FOLDERS.items():
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            name = ".".join((package, *parts)).removesuffix(".__init__")
            sources[name] = path.read_text(encoding="utf-8")
    return sources


MODULES = modules()


@cache
def imports(source: str) -> tuple[str, ...]:
    """Return the names of the modules that a source imports; a relative one begins with a dot."""
    return tuple(_imported(ast.walk(ast.parse(source))))


def _imported(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        match node:
            case ast.Import(names=names):
                yield from (alias.name for alias in names)
            case ast.ImportFrom(module=base, names=names, level=level):
                base = "." * level + (base or "")
                inner = [f"{base}.{alias.name}" for alias in names]
                yield from (name if name in MODULES else base for name in inner)
            case ast.Call(
                func=ast.Name(id="import_module" | "__import__")
                | ast.Attribute(attr="import_module"),
                args=[ast.Constant(value=str(name)), *_]
                | [ast.JoinedStr(values=[ast.Constant(value=str(name)), *_]), *_],
            ):
                yield name.rstrip(".")


def needs(sources: Mapping[str, str]) -> dict[str, set[str]]:
    """Return the modules that each one loads, at once or in a call; types alone load nothing."""
    loaded = {name: ast.parse(source) for name, source in sources.items()}
    for tree in loaded.values():
        tree.body = [node for node in tree.body if not _for_types_only(node)]
    return {
        name: {other for other in _imported(ast.walk(tree)) if other in sources and other != name}
        for name, tree in loaded.items()
    }


def _for_types_only(node: ast.stmt) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
