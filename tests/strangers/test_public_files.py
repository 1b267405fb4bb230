"""Public FMUs and SSP files: each gives its reference values, or is rejected in one sentence."""

import os
import tomllib
from pathlib import Path

import pytest

import cosim

HERE = Path(__file__).parent
FOLDER = Path(os.environ.get("COSIM_STRANGERS", HERE / "files"))
TABLES = tomllib.loads((HERE / "files.toml").read_text())
LISTED = TABLES["file"]
READABLE = {path for row in LISTED for path in row["files"] if row.get("opens", True)}
METHODS = ["jacobi", "gauss_seidel", "extrapolated", "iterated"]


def rows(key, listed=LISTED):
    found = [(path, row) for row in listed if key in row for path in row["files"]]
    return pytest.mark.parametrize(
        ("path", "row"), found, ids=[f"{path}-{i}" for i, (path, _) in enumerate(found)]
    )


@pytest.fixture
def present():
    """Return a function that returns where a public file is; skips where it is not."""

    def find(path):
        if not (FOLDER / path).exists():
            pytest.skip(f"{path} is not in {FOLDER}; files.toml says where it is from")
        return FOLDER / path

    return find


@rows("expected")
def test_public_file_gives_its_reference_values(path, row, present):
    run = cosim.simulate_fmu(
        present(path),
        interface=row["interface"],
        stop_time=row["stop_time"],
        outputs=[*row["expected"]],
        relative_tolerance=1e-8,
        start_values=row.get("start"),
    )
    for name, value in row["expected"].items():
        assert run.final[name] == pytest.approx(value, rel=row["tolerance"], abs=row["tolerance"])


@rows("refused")
def test_public_file_that_cannot_run_is_rejected_in_one_sentence(path, row, present):
    with pytest.raises(cosim.CosimError, match=row["refused"]) as caught:
        cosim.simulate_fmu(present(path), start_values=row.get("start"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("method", METHODS)
@rows("drives")
def test_public_file_is_a_part_with_every_method(path, row, method, present):
    follower = Path(path).with_name("Feedthrough.fmu")
    parts = {"first": present(path), "second": present(follower)}
    name, given = f"first.{row['drives']}", "second.Float64_continuous_input"
    coupled = cosim.couple(parts, {given: name}).simulate(
        stop_time=1.0, macro_step=0.01, method=method
    )
    alone = cosim.simulate_fmu(
        present(path), interface="CoSimulation", stop_time=1.0, output_interval=0.01
    )
    assert coupled.status == "complete"
    assert coupled.final[name] == pytest.approx(alone.final[row["drives"]], rel=1e-12)
    assert coupled.final[given] == coupled.final[name]


@rows("accuracy")
def test_public_file_with_fixed_steps_keeps_an_accuracy(path, row, present):
    parts = {"first": present(path), "second": present(Path(path).with_name("Feedthrough.fmu"))}
    wires = {"second.Float64_continuous_input": f"first.{row['drives']}"}
    run = cosim.couple(parts, wires).simulate(stop_time=1.0, accuracy=row["accuracy"])
    alone = cosim.simulate_fmu(present(path), interface="CoSimulation", stop_time=1.0)
    assert run.final[f"first.{row['drives']}"] == pytest.approx(alone.final[row["drives"]])


@pytest.mark.parametrize("path", sorted(READABLE))
def test_public_file_is_described(path, present):
    text = str(cosim.info(present(path)))
    assert f"fmi          {Path(path).parent.name}" in text


@rows("parts", TABLES["system"])
def test_public_system_is_read_and_gives_its_reference_values(path, row, present):
    system = cosim.read_ssp(present(path))
    assert len(system.parts) == row["parts"]
    if "expected" in row:
        accuracy = row.get("accuracy")
        steps = {"accuracy": accuracy} if accuracy else {"macro_step": 0.5}
        final = system.simulate(output_interval=0.5, **steps).final
        found = {name: final[name] for name in row["expected"]}
        assert found == pytest.approx(row["expected"], rel=accuracy or 0.0, abs=0.0)


@rows("refused", TABLES["system"])
def test_public_system_is_rejected_in_one_sentence_that_names_it(path, row, present):
    with pytest.raises(cosim.CosimError, match=row["refused"]) as caught:
        cosim.read_ssp(present(path))
    assert str(caught.value).startswith(str(present(path)))
    assert "\n" not in str(caught.value)
