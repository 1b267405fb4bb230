"""Archives that reach out: nothing of them is written, and their XML reads nothing."""

import stat
import struct
import tempfile
import zipfile
from pathlib import Path

import pytest

from cosim.errors import FmuError, SecurityError
from cosim.fmi.archive import DESCRIPTION, opened, unpacked
from cosim.fmi.check.check import check_fmu
from cosim.fmi.run.simulate import simulate_fmu

PLAIN = b"<fmiModelDescription fmiVersion='2.0'/>"


@pytest.fixture
def temporary(tmp_path, monkeypatch) -> Path:
    """A folder for temporary files of this test alone."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def archive(path: Path, *entries: tuple[zipfile.ZipInfo | str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in ((DESCRIPTION, PLAIN), *entries):
            file.writestr(name, content)
    return path


def refused(path: Path, temporary: Path, error: type[Exception] = SecurityError) -> str:
    """Return why an archive is refused; nothing may be left of it."""
    before = sorted(path.parent.rglob("*"))
    with pytest.raises(error) as caught, unpacked(path):
        pass
    assert type(caught.value) is error
    assert list(temporary.iterdir()) == []
    assert sorted(path.parent.rglob("*")) == before
    return str(caught.value)


@pytest.mark.parametrize(
    "name",
    [
        "../outside.txt",
        "a/../../outside.txt",
        "/outside.txt",
        "C:/outside.txt",
        "C:outside.txt",
        "..\\outside.txt",
        "\\\\server\\share\\outside.txt",
        "\\outside.txt",
    ],
)
def test_entry_that_leads_outside_is_refused(name, tmp_path, temporary):
    path = archive(tmp_path / "bad.fmu", (name, b"x"))
    assert "lies outside the archive" in refused(path, temporary)


def test_null_character_in_a_name_is_refused(tmp_path, temporary):
    path = archive(tmp_path / "bad.fmu", ("note_.txt", b"x"))
    path.write_bytes(path.read_bytes().replace(b"note_.txt", b"note\0.txt"))
    assert "lies outside the archive" in refused(path, temporary)


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR])
def test_link_or_device_is_refused(kind, tmp_path, temporary):
    entry = zipfile.ZipInfo("binaries/link")
    entry.external_attr = (kind | 0o777) << 16
    path = archive(tmp_path / "bad.fmu", (entry, b"/etc/passwd"))
    assert "is a link or device" in refused(path, temporary)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("name", [DESCRIPTION, "ModelDescription.XML", "Modeldescription.xml/"])
def test_name_that_occurs_twice_is_refused_whatever_its_case(name, tmp_path, temporary):
    path = archive(tmp_path / "bad.fmu", (name, b"<other/>"))
    assert "occurs twice" in refused(path, temporary)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_copies_of_an_entry_are_harmless_but_not_under_names_that_clash(tmp_path, temporary):
    twice = [("extra/", b""), ("extra/notes.xml", b"<notes/>")] * 2
    with opened(archive(tmp_path / "copies.fmu", *twice)) as found:
        assert len(found.infolist()) == 5
    path = archive(tmp_path / "case.fmu", ("ModelDescription.xml", PLAIN))
    assert "occurs twice" in refused(path, temporary)


def test_bomb_is_refused_before_it_goes_off(tmp_path, temporary):
    path = archive(tmp_path / "bomb.fmu", ("large.bin", bytes(1000)))
    said = path.read_bytes().replace(struct.pack("<I", 1000), struct.pack("<I", 2**31))
    path.write_bytes(said)
    assert "unpacks to 2.15e+09 bytes, more than 1073741824" in refused(path, temporary)


def test_limit_of_the_unpacked_size_can_be_chosen(tmp_path):
    path = archive(tmp_path / "large.fmu", ("large.bin", bytes(2000)))
    with pytest.raises(SecurityError, match="more than 1000"), unpacked(path, most_bytes=1000):
        pass
    with unpacked(path, most_bytes=5000) as folder:
        assert (folder / "large.bin").stat().st_size == 2000


def test_what_no_run_reads_stays_packed(tmp_path):
    """Most files of an FMU are headers: to unpack them took longer than many runs."""
    read = {DESCRIPTION, "resources/a.h", "resources/documentation/a", "sources/a.c", "a.h"}
    never = {"documentation/index.html", "sources/a.h", "sources/more/a.h"}
    path = archive(
        tmp_path / "a.fmu", *((name, b"") for name in sorted(never | read - {DESCRIPTION}))
    )
    for to_run, wanted in ((True, read), (False, read | never)):
        with unpacked(path, to_run=to_run) as folder:
            files = [file for file in folder.rglob("*") if file.is_file()]
            assert {file.relative_to(folder).as_posix() for file in files} == wanted


def test_too_many_entries_are_refused(tmp_path, temporary):
    path = archive(tmp_path / "many.fmu", *((str(i), b"") for i in range(10_001)))
    assert "10002 entries" in refused(path, temporary)


def test_entry_larger_than_it_says_is_not_unpacked(tmp_path, temporary):
    path = archive(tmp_path / "lie.fmu", ("large.bin", bytes(100_000)))
    honest, content = struct.pack("<I", 100_000), path.read_bytes()
    assert content.count(honest) == 2  # in the entry's own header and in the directory
    path.write_bytes(content.replace(honest, struct.pack("<I", 10)))
    assert "cannot unpack" in refused(path, temporary, FmuError)


@pytest.mark.parametrize("keep", [0, 10, 200, -1])
def test_truncated_file_is_refused(keep, tmp_path, temporary):
    path = archive(tmp_path / "cut.fmu", ("note.txt", b"x" * 500))
    path.write_bytes(path.read_bytes()[:keep])
    assert "is not a zip archive" in refused(path, temporary, FmuError)


def test_damaged_entry_is_refused(tmp_path, temporary):
    path = tmp_path / "bad.fmu"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(DESCRIPTION, PLAIN)
        file.writestr("note.txt", b"exactly this text")
    path.write_bytes(path.read_bytes().replace(b"exactly this", b"exactly that"))
    assert "Bad CRC-32" in refused(path, temporary, FmuError)


def test_missing_file_is_told(tmp_path):
    with pytest.raises(FmuError, match=r"gone\.fmu: No such file"), opened(tmp_path / "gone.fmu"):
        pass


def test_archive_without_description_is_told(tmp_path):
    path = tmp_path / "empty.fmu"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("note.txt", b"")
    with pytest.raises(FmuError, match=r"has no modelDescription\.xml"), opened(path):
        pass


BILLION_LAUGHS = b"""<!DOCTYPE a [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]><a>&c;</a>"""
DANGEROUS = {
    "external entity": b'<!DOCTYPE a [<!ENTITY e SYSTEM "file:///etc/passwd">]><a>&e;</a>',
    "parameter entity": b'<!DOCTYPE a [<!ENTITY % e SYSTEM "http://192.0.2.1/e"> %e;]><a/>',
    "external subset": b'<!DOCTYPE a SYSTEM "http://192.0.2.1/a.dtd"><a/>',
    "billion laughs": BILLION_LAUGHS,
    "in UTF-16": BILLION_LAUGHS.decode().encode("utf-16"),
}


@pytest.mark.parametrize("content", DANGEROUS.values(), ids=DANGEROUS)
@pytest.mark.parametrize("entry", [DESCRIPTION, "sources/buildDescription.xml"])
def test_document_type_is_refused(entry, content, tmp_path, temporary):
    path = tmp_path / "bad.fmu"
    with zipfile.ZipFile(path, "w") as file:
        for name, text in ({DESCRIPTION: PLAIN} | {entry: content}).items():
            file.writestr(name, text)
    assert f"{entry} declares a document type" in refused(path, temporary)


@pytest.mark.parametrize(
    ("content", "error", "reason"),
    [
        (b"<a>" * 100_000, SecurityError, "nests 65 elements"),
        (b"<a b='" + b"x" * 2**26 + b"'/>", SecurityError, "has more than 67108864 bytes"),
        (b"<?xml version='1.0' encoding='klingon'?><a/>", FmuError, "is not well-formed"),
        (b"<?xml version='1.0' encoding='UTF-16'?><a/>", FmuError, "is not well-formed"),
        (b"\xff\xfe<", FmuError, "is not well-formed"),
        (b"", FmuError, "is not well-formed"),
    ],
    ids=["deep", "large", "unknown encoding", "wrong encoding", "cut", "empty"],
)
def test_xml_that_breaks_readers_is_refused(content, error, reason, tmp_path, temporary):
    path = tmp_path / "bad.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(DESCRIPTION, content)
    assert reason in refused(path, temporary, error)


def test_inclusions_stay_text(tmp_path):
    """XInclude is an element like any other for who does not ask for it."""
    include = b"<a xmlns:x='http://www.w3.org/2001/XInclude'><x:include href='/etc/passwd'/></a>"
    path = tmp_path / "note.fmu"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(DESCRIPTION, include)
    with pytest.raises(FmuError) as caught:
        simulate_fmu(path)
    assert "root:" not in str(caught.value)


@pytest.mark.parametrize("kind", [zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_an_entry_that_cannot_be_unpacked_ends_in_one_sentence(kind, tmp_path):
    """Its size in the directory leads beyond the archive, or its content is none of its kind."""
    path = tmp_path / "damaged.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", "<a/>")
        archive.writestr("last", bytes(range(256)) * 40, kind)
    content = bytearray(path.read_bytes())
    entry = content.rindex(b"PK\x01\x02")
    if kind == zipfile.ZIP_STORED:
        content[entry + 20 : entry + 28] = struct.pack("<2I", 10**6, 10**6)
    else:
        place = content.index(b"last", content.index(b"last") - 1) + 4
        content[place + 12 : place + 40] = bytes(28)
    path.write_bytes(content)
    with (
        pytest.raises(FmuError, match="cannot unpack") as caught,
        unpacked(path, description="SystemStructure.ssd"),
    ):
        pass
    assert "Error" not in str(caught.value)


@pytest.mark.parametrize("method", ["read", "extractall", "testzip"])
def test_a_lack_of_memory_is_no_damage_of_the_archive(method, tmp_path, monkeypatch):
    path = archive(tmp_path / "plain.fmu")

    def fail(*_arguments):
        raise MemoryError

    monkeypatch.setattr(zipfile.ZipFile, method, fail)
    with pytest.raises(MemoryError), unpacked(path):
        check_fmu(path, libraries=False)
