"""Files that are too large, have no text in them, numbers without end, or brackets within brackets;
nothing is unpickled.
"""

import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

import phdtrack
from phdtrack.config import load as load_settings
from phdtrack.errors import InputError
from phdtrack.files import MAX_SIZE, SIZE_LIMIT, load, read_json, read_toml, read_xml, write_text
from phdtrack.formats import read_detections, read_tracks, read_truth
from phdtrack.formats.truth import ignoring
from phdtrack.ground import read_camera
from phdtrack.ground.terrain import read_terrain
from phdtrack.live.zones import read_places
from phdtrack.scene import read_scene
from phdtrack.video import open_source


def put(folder: Path, content: bytes) -> Path:
    path = folder / "file"
    path.write_bytes(content)
    return path


def json_of(path: Path) -> object:
    return read_json(path, path.read_bytes())


def xml_of(path: Path) -> object:
    return read_xml(path, path.read_bytes())


@pytest.mark.parametrize(
    ("reader", "content", "where", "words"),
    [
        (json_of, b'{"a":\n' + b"9" * 5000 + b"}", ", line 2", "hundreds of digits"),
        (read_toml, b"a = 1\nb = " + b"9" * 5000, ", line 2", "hundreds of digits"),
        (read_toml, b"a = 0x" + b"f" * 5000, ", line 1", "hundreds of digits"),
        (json_of, b"[" * 100_000, "", "nested without end"),
        (
            read_toml,
            b"b = 1\n" + b"a." * 20_000 + b"a = 1",
            ", line 2",
            "a name, got one of a hundred parts",
        ),
        (read_toml, b"a = " + b"[" * 100_000, "", "nested without end"),
        (read_toml, b"a = " + b"{a=" * 100_000, "", "nested without end"),
        (read_toml, b"a = 1\nb = [3\n", ", line 2", "not TOML"),
        (xml_of, b"\n<a>" * 100_000, ", line 102", "at most 100 elements within each other"),
        (xml_of, b'<?xml version="1.0" encoding="utf-7"?><a/>', ", line 1", "UTF-8"),
        (xml_of, b'<?xml version="1.0" encoding="big5"?><a/>', ", line 1", "UTF-8"),
        (xml_of, b"<a>\0</a>", ", line 1", "XML, which breaks here"),
        (
            read_scene,
            b'{"format": 1, "width": 1e400, "height": 1, "rate": 1, "source": ""}',
            "",
            "not a learned scene",
        ),
        (
            read_scene,
            b'{"format": 1, "width": 1, "height": 1, "rate": ' + b"9" * 400 + b"}",
            ", line 1",
            "hundreds of digits",
        ),
        (
            read_scene,
            b'{"format": ' + b"[" * 500 + b"]" * 500 + b"}",
            "",
            "a learned scene of format 1",
        ),
        (
            load_settings,
            b"[sensor]\ndetection_probability = " + b"9" * 400,
            ", line 2",
            "hundreds of digits",
        ),
        (
            read_places,
            b'[[line]]\nname = "a"\npoints = [[0, 1e400], [1, 1]]',
            ", [[line]] number 1",
            "finite",
        ),
        (
            read_camera,
            b"homography = [[1e308, 0, 0], [0, 1e308, 0], [0, 0, 1]]\nunit = 'mm'",
            "",
            "can be inverted",
        ),
        (
            read_camera,
            b'{"camera_matrix": [[1e400]], "dist": [], "rvec": [1], "tvec": [1]}',
            "",
            "not finite|3 x 3",
        ),
        (read_camera, b'file = "a\\u0000b"', ", '", "NUL"),
        (read_detections, b"[{" * 300, ", line 1", "JSON, which breaks here"),
        (
            read_detections,
            b'{"annotations": [], "categories": [{"id": 1e400}]}',
            ", category 1",
            "whole number",
        ),
        (read_detections, b"1 2 Car" + b" 3" * 14 + b"\n1 2\n", ", line 2", "expected 17 columns"),
        (
            read_detections,
            b"frame,id,left,top,width,height,class\n1,2\n",
            ", line 2",
            "expected 7 values",
        ),
        (read_detections, b"1,-1,1,2,3\0,4\n", ", line 1", "not UTF-8 text"),
        (read_truth, b"1,1,1e400,2,3,4,1\n", ", line 1", "finite numbers"),
        (read_tracks, b"frame,id,left,top,width,height,class\n", "", ""),
        (
            lambda path: ignoring(read_truth(path), path),
            b"1,1e300,1,2,3,4\n",
            ", line 1",
            "identity",
        ),
        (read_terrain, b"PK\x03\x04" + bytes(100), "", "ASCII grid"),
    ],
)
def test_a_sentence_with_the_place(
    tmp_path: Path, reader: Callable[[Path], object], content: bytes, where: str, words: str
) -> None:
    path = put(tmp_path, content)
    if not words:
        reader(path)
        return
    with pytest.raises(InputError, match=words) as caught:
        reader(path)
    assert caught.value.where.startswith(f"{path}{where}")


@pytest.mark.parametrize("distortion", [1e300, 4.9e-324])
def test_lenses_beyond_all_numbers(tmp_path: Path, distortion: float) -> None:
    """What is next to nothing bends nothing."""
    text = (
        "camera_matrix = [[800, 0, 320], [0, 800, 240], [0, 0, 1]]\ndistortion_coefficients ="
        f" [{distortion}, 0.1, 0, 0]\n"
    )
    path = put(tmp_path, (text + "rvec = [1.9, 0.1, 0.2]\ntvec = [0, 0, 9]\n").encode())
    if distortion < 1:
        read_camera(path)
        return
    with pytest.raises(InputError, match="finite distortion coefficients of at most"):
        read_camera(path)


def test_a_setting_of_thousands_of_digits_is_a_mistake() -> None:
    for value in ("9" * 5000, "[" * 100_000):
        with pytest.raises(InputError, match="detection_probability"):
            load_settings(sets=[f"sensor.detection_probability={value}"])


def test_names_with_nul() -> None:
    with pytest.raises(InputError, match="NUL"):
        load("a\0b")


def test_the_largest_file_is_stated_and_can_be_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = put(tmp_path, b"1,-1,10,20,30,60,0.5\n")
    assert MAX_SIZE == 4_000_000_000
    monkeypatch.setenv(SIZE_LIMIT, "21")
    assert len(read_detections(path)) == 1
    monkeypatch.setenv(SIZE_LIMIT, "20")
    for reader in (read_detections, read_truth, read_camera, read_scene, load_settings):
        with pytest.raises(InputError, match="at most 20 bytes, got 21") as caught:
            reader(path)
        assert "--max-file-size" in caught.value.cure
    monkeypatch.setenv(SIZE_LIMIT, "many")
    with pytest.raises(InputError, match="a number of bytes, got 'many'"):
        load(path)


def test_a_sparse_file_of_terabytes_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large.csv"
    with path.open("wb") as file:
        file.truncate(1 << 42)
    with pytest.raises(InputError, match="at most 4,000,000,000 bytes, got 4,398,046,511,104"):
        read_detections(path)


@pytest.mark.parametrize(
    "content",
    [b"", b"\0" * 5000, b"RIFF\x10\0\0\0AVI LIST" + b"\xff" * 200, b"\x1aE\xdf\xa3" + bytes(99)],
)
def test_what_is_no_video(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"video|decoded"):
        list(open_source(path))


def test_nothing_that_is_read_can_run() -> None:
    """No unpickling, nothing of `marshal`, no `eval` of texts. SciPy's readers, which die of broken
    files, run only in the process that reads a MATLAB file (`ground.matlab`). Of what a process
    gives the one that compiles for it, in a folder that only they can write, only known classes
    are read.
    """
    root = Path(phdtrack.__file__).parent
    pattern = re.compile(
        r"\b(pickle|cPickle|dill|marshal|shelve|scipy\.io|allow_pickle=True|loadmat)\b|(?<![\w.])(eval|exec)\("
    )
    found = []
    for path in root.rglob("*.py"):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            code = line.partition("#")[0]
            if (
                pattern.search(code)
                and not re.search(r"can be pickled", code)
                and path.name not in {"matlab.py", "compile_apart.py"}
                and "SECOND.offer(" not in code
                and code != "import pickle"
            ):
                found.append(f"{path.relative_to(root)}:{number} {line.strip()}")
    assert found == []
    assert all(
        "allow_pickle=False" in line
        for path in root.rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(r"\bnp\.load\(", line)
    )


def test_a_device_or_a_pipe_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, Path("/dev/null"), Path("/dev/stdout")):
        before = path.lstat().st_mode
        with pytest.raises(InputError, match="expected the name of a file"):
            write_text(path, "text")
        assert path.lstat().st_mode == before
    # That is a folder as others.
    if Path("/dev/shm").is_dir():
        with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
            write_text(Path(folder) / "a.txt", "text")
            assert (Path(folder) / "a.txt").read_text() == "text"
    with pytest.raises(InputError, match="cannot be written"):
        write_text(tmp_path / ("a" * 300), "text")
