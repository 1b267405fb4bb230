"""Size and shape of `src/cosim`: files, importers, parameters, and the call order of one run.

    python benchmarks/structure.py [TREE]

TREE is a checkout (default: this one) whose package this Python imports. The call order is a
trace (`sys.setprofile`) of a second call with the same arguments: a file counts each time a
function in it is called after one in another file; a climb is such a change into a higher layer of
`tests/test_layers.py`.
"""

import ast
import importlib
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from types import FrameType

MOST_PARAMETERS = 10
MODELS = ("bicycle", "bicycle/multipliers")
# Types and tables that once held what to run. `Configuration` is a label with a RunRequest; `Case`
# and `Counterpart` are rows of a table of names and numbers, which one function makes requests of.
CARRIERS = (
    "Shorthand", "Asked", "Settings", "native_settings", "Plan", "AskedTimes", "Span", "Way",
    "_Way", "Job", "Options", "_RUN_OPTIONS",
)  # fmt: skip


def main(tree: Path) -> None:
    folder = tree / "src" / "cosim"
    sys.path.insert(0, str(tree / "tests"))
    graph = importlib.import_module("helpers.import_graph")
    place = importlib.import_module("test_layers").place
    sources = {path: path.read_text(encoding="utf-8") for path in folder.rglob("*.py")}
    trees = {path: ast.parse(source) for path, source in sources.items()}

    print(f"files of src/cosim: {len(sources)}")
    print(f"lines of src/cosim: {sum(source.count(chr(10)) for source in sources.values())}")
    modules = {name_of(p, folder): p for p in sources if p.name != "__init__.py"}
    importers = Counter(
        other for name, found in graph.needs(graph.MODULES).items() for other in found
    )
    importers.update(public_modules(folder / "__init__.pyi"))
    single = [name for name in modules if importers[name] == 1]
    print(f"modules with one importer: {len(single)} of {len(modules)}")
    long = [found for path in trees for found in long_functions(trees[path], name_of(path, folder))]
    listed(f"functions with more than {MOST_PARAMETERS} parameters", long)
    listed("carriers", [f for path in trees for f in carriers(trees[path], name_of(path, folder))])

    import cosim

    assert Path(cosim.__file__).is_relative_to(folder), f"{sys.executable} imports another cosim"
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "model.fmu"
        for model in MODELS:
            dae = cosim.load(model)
            calls: dict[str, Callable[[], object]] = {
                "simulate": lambda dae=dae: cosim.simulate(dae, stop_time=0.1),
                "export_fmu": lambda dae=dae: cosim.export_fmu(dae, target),
            }
            for verb, call in calls.items():
                call()
                order = [name_of(Path(file), folder) for file in entered(call, str(folder))]
                layers = [(place(name) or (0, 0))[0] for name in order]
                climbs = sum(later > before for before, later in pairwise(layers))
                print(
                    f"{verb}({model}): {len(order)} files entered one after the other, "
                    f"{len(set(order))} distinct, {climbs} climbs"
                )


def name_of(path: Path, folder: Path) -> str:
    """Return the import name of a file."""
    parts = path.relative_to(folder.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


def listed(title: str, names: list[str]) -> None:
    print(f"{title}: {len(names)}", *names, sep="\n  ")


def public_modules(stub: Path) -> set[str]:
    """Return the modules that the package itself imports when a public name is first used."""
    tree = ast.parse(stub.read_text(encoding="utf-8"))
    return {str(node.module) for node in tree.body if isinstance(node, ast.ImportFrom)}


def long_functions(tree: ast.Module, module: str) -> Iterator[str]:
    """Yield the functions with too many parameters, `self` and `cls` not counted."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            own = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            names = [argument.arg for argument in own if argument.arg not in ("self", "cls")]
            if len(names) > MOST_PARAMETERS:
                yield f"{module}.{node.name}: {len(names)}"


def carriers(tree: ast.Module, module: str) -> Iterator[str]:
    """Yield the old carriers that a module still defines."""
    for node in tree.body:
        match node:
            case ast.ClassDef(name=name) if "RunRequest" not in ast.unparse(node):
                names = [name]
            case ast.FunctionDef(name=name):
                names = [name]
            case ast.Assign(targets=targets):
                names = [target.id for target in targets if isinstance(target, ast.Name)]
            case ast.AnnAssign(target=ast.Name(id=name)):
                names = [name]
            case _:
                continue
        # `Times` is now the name of the time grid in a RunRequest; in a plan it was a carrier
        old = (*CARRIERS, "Times") if module.endswith((".plan", ".preparation")) else CARRIERS
        yield from (f"{module}.{name}" for name in names if name in old)


def entered(call: Callable[[], object], folder: str) -> list[str]:
    """Return the files of a folder whose functions a call enters, changes of file only."""
    files: list[str] = []

    def record(frame: FrameType, event: str, _argument: object) -> None:
        file = frame.f_code.co_filename
        if event == "call" and file.startswith(folder) and (not files or files[-1] != file):
            files.append(file)

    threading.setprofile(record)
    sys.setprofile(record)
    try:
        call()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type] # None ends it; typeshed lacks that
    return files


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1]).resolve())
