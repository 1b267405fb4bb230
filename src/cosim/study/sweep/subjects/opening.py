"""From whatever names a model, a scene or an FMU to what can be run, in any process."""

import os
import pickle
from functools import lru_cache
from pathlib import Path
from typing import Any

from casadi_models.dae import Dae
from cosim.errors import UsageError
from cosim.model.catalogue import load
from cosim.scene.scene_file import read_scene
from cosim.study.sweep.subjects.model_subject import ModelSubject, scene_subject
from cosim.study.sweep.subjects.subject import Opened, Subject


def as_subject(given: Any) -> Subject:
    """Return what names a model, a scene or an FMU.

    Raises:
        UsageError: It is none of these.
    """
    if isinstance(given, Subject):
        return given
    if isinstance(given, Dae):
        return Subject("dae", pickle.dumps(given))
    if isinstance(given, str | os.PathLike):
        name = os.fspath(given)
        if Path(name).suffix in (".fmu", ".toml"):
            return Subject({".fmu": "fmu", ".toml": "scene"}[Path(name).suffix], str(_there(name)))
        path, colon, function = name.rpartition(".py:")
        return Subject("model", f"{Path(path + '.py').resolve()}:{function}" if colon else name)
    wanted = "a model's name, a Dae, SCENE.toml or FILE.fmu"
    raise UsageError.of_type("sweep", given, wanted)


def _there(name: str) -> Path:
    """Return the whole path of a file; a shipped scene keeps its name."""
    path = Path(name)
    return path.resolve() if path.exists() else path


@lru_cache(2)
def opened_subject(subject: Subject) -> Opened:
    """Open a subject; each process keeps the last two.

    Raises:
        CosimError: The model, the scene or the file is wrong.
    """
    if subject.kind == "fmu":
        from cosim.study.sweep.subjects.fmu_subject import FmuSubject

        return FmuSubject(str(subject.source))
    if subject.kind == "scene":
        return scene_subject(read_scene(str(subject.source)))
    if isinstance(subject.source, bytes):
        return ModelSubject(pickle.loads(subject.source), {}, {}, None)
    return ModelSubject(load(subject.source), {}, {}, None)
