"""The store of a sweep: damage is found and repaired, one writer at a time, full disks are said."""

import errno
import os
import pickle
import shutil
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from casadi_models.dae import Model
from cosim.errors import ExportError, UsageError
from cosim.study.sweep.block import COMPLETE, Block
from cosim.study.sweep.reductions import Keep, moments_of
from cosim.study.sweep.samples import Samples
from cosim.study.sweep.store import Layout, Store, stored_samples
from cosim.study.sweep.sweep import sweep
from cosim.trajectory import Column

zarr = pytest.importorskip("zarr")

COLUMNS = (Column("a", "m", "place"), Column("b", "m", "place"))
VALUES = np.random.default_rng(0).normal(size=(40, 5, 2))
VALUES[16:32, :, 1] = np.nan  # the fill value of the array


def layout(samples=None):
    samples = Samples({"p": np.arange(40.0)}) if samples is None else samples
    manifest = {"model": "m", "samples": samples.origin, "samples_digest": samples.digest}
    return Layout(manifest, samples, COLUMNS, np.arange(5.0), Keep(True, True, ()), 16)


def block(first, count):
    part = slice(first, first + count)
    numbers = {"sum": VALUES[part].sum(axis=(1, 2))}
    states = np.full(count, COMPLETE, dtype=np.int8)
    states[: first // 16] = COMPLETE + 1
    steps = np.arange(first, first + count)
    moments = moments_of(VALUES[part], np.ones(count, dtype=bool))
    return Block(first, states, steps, steps, {first: f"ä {first}"}, numbers, VALUES[part], moments)


def fill(store):
    finished = store.finished()
    for part in store.layout.blocks():
        if part not in finished:
            store.write(block(*part))
    store.finish()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep") / "store"
    with Store.opened(layout(), folder, resume=False) as store:
        fill(store)
    return folder


@pytest.fixture
def folder(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "store")


@pytest.mark.parametrize("name", ["a/b", "../b", "", ".", "zarr.json", "blocks/b"])
def test_names_that_no_folder_has_are_rejected(name, tmp_path):
    part = replace(block(0, 16), numbers={name: np.zeros(16)})
    with Store.opened(layout(), tmp_path / "store", resume=False) as store:
        with pytest.raises(UsageError, match=f"'{name}' cannot be the name of a folder"):
            store.write(part)
        assert store.finished() == []
    samples = Samples({name: np.arange(40.0)})
    with pytest.raises(UsageError, match="cannot be the name of a folder"):
        Store.created(layout(samples), tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_names_that_differ_in_case_only_need_a_place_where_case_counts(tmp_path, monkeypatch):
    def exists(path):
        names = [one.name.lower() for one in path.parent.iterdir()] if path.parent.is_dir() else []
        return path.name.lower() in names

    both = layout(Samples({"m": np.arange(40.0), "M": np.arange(40.0)}))
    Store.created(both, tmp_path / "both")
    monkeypatch.setattr(Path, "exists", exists)
    with pytest.raises(UsageError, match="'M' cannot be the name of a folder of its own"):
        Store.created(both, tmp_path / "one")


def content(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def flip_a_bit(file):
    raw = bytearray(file.read_bytes())
    raw[len(raw) // 2] ^= 1
    file.write_bytes(raw)


def cut(file):
    file.write_bytes(file.read_bytes()[:-3])


def empty(file):
    file.write_bytes(b"")


def take_the_neighbors(file):
    blocks = [p for p in file.parents if p.parent.name == "c"] or [file]
    file.write_bytes((blocks[0].parent / "0" / file.relative_to(blocks[0])).read_bytes())


def replace_by_a_folder(file):
    file.unlink()
    file.mkdir()


DAMAGES = [os.unlink, flip_a_bit, cut, empty, take_the_neighbors, replace_by_a_folder]


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("status/c/1-unlink")
@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
@pytest.mark.parametrize(
    "array", ["status/c/1", "reason/c/1", "sum/c/1", "a/c/1/0", "b/c/1/0", "blocks/mean/c/1/0/0"]
)
def test_a_damaged_block_is_named_and_computed_again(whole, folder, array, damage):
    damage(folder / array)
    with ExitStack() as held:
        with pytest.warns(RuntimeWarning, match="results of the runs 16 to 31 were damaged"):
            store = held.enter_context(Store.opened(layout(), folder, resume=True))
        assert store.finished() == [(0, 16), (32, 8)]
        fill(store)
    assert content(folder) == content(whole)


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    "file",
    ["a/zarr.json", "status/zarr.json", "blocks/zarr.json", "blocks/digest/zarr.json", "p/c/1",
     "p/zarr.json", "time/c/0", "sum/zarr.json"],
)  # fmt: skip
@pytest.mark.parametrize("damage", [os.unlink, flip_a_bit, cut, empty, replace_by_a_folder])
def test_damaged_descriptions_and_samples_are_restored(whole, folder, file, damage):
    damage(folder / file)
    with Store.opened(layout(), folder, resume=True) as store:
        fill(store)
    assert content(folder) == content(whole)


def test_a_block_without_digest_is_computed_again(whole, folder):
    (folder / "blocks/digest/c/2/0").unlink()  # as after a kill before the end of the block
    (folder / "a/c/2/0").unlink()
    with Store.opened(layout(), folder, resume=True) as store:
        assert store.finished() == [(0, 16), (16, 16)]
        fill(store)
    assert content(folder) == content(whole)


@pytest.mark.parametrize("damage", [os.unlink, flip_a_bit, cut, empty])
@pytest.mark.parametrize("file", ["p/c/0", "p/c/2", "p/zarr.json"])
def test_damaged_samples_are_not_taken_from_a_store(folder, file, damage):
    damage(folder / file)
    with pytest.raises(UsageError, match=r"the stored samples are damaged; name them again"):
        stored_samples(folder)


def test_a_damaged_array_is_not_read(folder):
    with Store.opened(layout(), folder, resume=True) as store:
        flip_a_bit(folder / "a/c/1/0")
        with pytest.raises(UsageError, match="the array a is damaged; repeat the sweep with"):
            store["a"]
        np.testing.assert_array_equal(store.read("a", 0), VALUES[0, :, 0])


def test_a_second_writer_is_rejected_and_a_pickled_store_is_read(folder):
    with Store.opened(layout(), folder, resume=True) as store:
        with (
            pytest.raises(UsageError, match=r"another sweep is writing to .*; wait until it has"),
            Store.opened(layout(), folder, resume=True),
        ):
            pass
        assert pickle.loads(pickle.dumps(store))["a"].shape == (40, 5)
    with Store.opened(layout(), folder, resume=True):
        pass


FULL = """
import errno, os, pathlib, sys
import numpy as np
from cosim.study.sweep.folder import Folder
usual = pathlib.Path.replace
def full(path, target):
    if "/c/" in pathlib.Path(target).as_posix():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    return usual(path, target)
pathlib.Path.replace = full
try:
    Folder(pathlib.Path(sys.argv[1])).add("p", (400,), (1,), ("run",), np.arange(400.0), {})
except OSError as error:
    print(error.strerror)
"""


@pytest.mark.slow
def test_no_write_is_left_open_where_one_finds_the_disk_full(tmp_path):
    words = [sys.executable, "-c", FULL, str(tmp_path / "store")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == (f"{os.strerror(errno.ENOSPC)}\n", "")


def test_a_full_disk_ends_in_one_sentence(folder, monkeypatch):
    (folder / "blocks/digest/c/1/0").unlink()
    with Store.opened(layout(), folder, resume=True) as store:

        def full(*_):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patch:
            patch.setattr("pathlib.Path.replace", full)
            with pytest.raises(ExportError, match=r"cannot write .*: No space left .*--resume"):
                fill(store)
    with Store.opened(layout(), folder, resume=True) as store:
        assert store.finished() == [(0, 16), (32, 8)]


def test_a_disk_that_is_full_from_the_start_leaves_nothing(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    target = tmp_path / "store"
    monkeypatch.setattr("pathlib.Path.replace", full)
    with pytest.raises(ExportError) as caught:
        Store.created(layout(), target)
    assert str(caught.value) == f"cannot create {target}: {os.strerror(errno.ENOSPC)}"
    assert list(tmp_path.iterdir()) == []


def _with_names(parameter, output):
    model = Model("named", stop_time=1.0)
    x = model.state("x", "m", 1.0, "place")
    rate = model.parameter(parameter, "1/s", 1.0, "rate")
    model.derivative(x, -rate * x)
    model.output(output, "m", 2 * x, "twice")
    return model.freeze()


@pytest.mark.parametrize("name", ["steps", "status", "reached", "x_final"])
def test_a_varied_quantity_has_the_name_of_no_result(tmp_path, name):
    given = {name: [2.0, 3.0]}
    keep = {"keep": ["trajectories", "final"], "workers": 0}
    found = sweep(_with_names(name, "y"), given, store=tmp_path / "s", **keep)
    np.testing.assert_array_equal(found.samples.columns[name], [2.0, 3.0])
    assert [{2.0, 3.0} & {*row.values()} for row in found.rows()] == [{2.0}, {3.0}]
    stored = found.to_xarray()
    np.testing.assert_array_equal(stored[f"{name}_start"], [2.0, 3.0])
    np.testing.assert_array_equal(stored["steps"], found.steps)
    np.testing.assert_allclose(stored["x_final"], np.exp([-2.0, -3.0]), rtol=1e-4)
    again = sweep(_with_names(name, "y"), store=tmp_path / "s", resume=True, **keep)
    np.testing.assert_array_equal(again.samples.columns[name], [2.0, 3.0])


@pytest.mark.parametrize("name", ["steps", "reason"])
def test_a_trajectory_with_the_name_of_another_result_is_rejected(name):
    with pytest.raises(UsageError, match=rf"under the name '{name}'.*leave it out of outputs"):
        sweep(_with_names("rate", name), {"rate": [1.0]}, keep=["trajectories"], workers=0)
