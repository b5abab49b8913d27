"""seqinfo.ini: its location, and errors about malformed files."""

from pathlib import Path

import pytest
from format_cases import put, refused

from phdtrack.errors import InputError
from phdtrack.formats import find_seqinfo, read_seqinfo
from phdtrack.types import SequenceInfo

GOOD = (
    "[Sequence]\nname=S1\nimDir=img1\nframeRate=12.5\nseqLength=70\nimWidth=640\nimHeight=480\n"
    "imExt=.jpg\n"
)
INFO = SequenceInfo(width=640, height=480, fps=12.5, frames=70, name="S1")
NAME = "seqinfo.ini"


def test_seqinfo_is_read_from_file_or_folder(tmp_path: Path) -> None:
    assert read_seqinfo(put(tmp_path, GOOD, NAME)) == read_seqinfo(tmp_path) == INFO
    put(tmp_path, "\ufeff" + GOOD.replace("\n", "\r\n"), NAME)
    assert read_seqinfo(str(tmp_path)) == INFO
    put(tmp_path, GOOD.replace("seqLength=70\n", "").replace("name=S1\n", ""), NAME)
    assert read_seqinfo(tmp_path) == SequenceInfo(640, 480, 12.5, 0, tmp_path.name)


def test_seqinfo_is_found_beside_and_one_folder_up(tmp_path: Path) -> None:
    deep = tmp_path / "det" / "more"
    deep.mkdir(parents=True)
    with pytest.raises(InputError, match="no such file"):
        read_seqinfo(tmp_path)
    assert find_seqinfo(deep / "det.txt") is None
    put(tmp_path, GOOD, NAME)
    assert find_seqinfo(tmp_path / "det.txt") == INFO
    assert find_seqinfo(tmp_path / "det" / "det.txt") == INFO
    assert find_seqinfo(tmp_path / "det") == INFO
    assert find_seqinfo(deep / "det.txt") is None


@pytest.mark.parametrize(
    ("content", "where", "words"),
    [
        ("[Other]\na=1\n", "", "a section [Sequence], got none"),
        ("name=x\n" + GOOD, ", line 1", "File contains no section headers"),
        (GOOD + "what is this\n", ", line 9", "frameRate=25"),
        (GOOD + "name=again\n", ", line 9", "frameRate=25"),
        (GOOD.replace("frameRate=12.5\n", ""), "", "a value for frameRate, got none"),
        (
            GOOD.replace("640", "wide"),
            ", line 6",
            "a whole number above 0 for imWidth, got 'wide'",
        ),
        (
            GOOD.replace("70", "70.5"),
            ", line 5",
            "a whole number above 0 for seqLength, got '70.5'",
        ),
        (GOOD.replace("12.5", "nan"), ", line 4", "a number above 0 for frameRate, got 'nan'"),
        (b"\xff\xff", "", "expected UTF-8 text"),
    ],
)
def test_malformed_seqinfo_is_refused(
    tmp_path: Path, content: str | bytes, where: str, words: str
) -> None:
    refused(read_seqinfo, put(tmp_path, content, NAME), where, words)
    with pytest.raises(InputError):
        find_seqinfo(tmp_path / "det.txt")
