"""SSP files with the FMUs of a gain and of a source."""

import pytest
from helpers.ssp_files import description, gain, package, source

import cosim


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmus")
    return [cosim.export_fmu(m, folder / f"{m.name}.fmu", valid=False) for m in (gain(), source())]


@pytest.fixture
def write(fmus, tmp_path):
    def written(whole, after="", name="case", **entries):
        return package(tmp_path / f"{name}.ssp", fmus, description(whole, after), **entries)

    return written


@pytest.fixture
def read(write):
    return lambda *content, **entries: cosim.read_ssp(write(*content, **entries))
