"""What is installed: little for those who only call `Tracker`, and what is missing is said with the
line that brings it.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
import venv
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from cli_runner import phdtrack, refused, walkers

from phdtrack import opencv_package
from phdtrack.cli.app import COMMANDS
from phdtrack.errors import EXTRAS
from programs import finished

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Modules that a core installation lacks, as they would be: nothing can import them.
WITHOUT = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
"""
LOOP = """
import pickle
import numpy as np
from phdtrack import Detections, Tracker, evaluate
from phdtrack.final_rows import FinalTracks

tracker, rows = Tracker(frame_size=(640, 480), fps=25), []
tracker.warm_up()
final = FinalTracks(tracker)
for k in range(30):
    one = [100 + 4 * k, 100, 140 + 4 * k, 200, 0.9, 0]
    other = [400 - 3 * k, 250, 440 - 3 * k, 350, 0.8, 0]
    boxes = np.array([one, other])
    rows += list(tracker.update(boxes if k % 7 else Detections.empty(), warp=np.eye(3)))
    final.due()
again = Tracker(frame_size=(640, 480), fps=25)
again.load_state_dict(pickle.loads(pickle.dumps(tracker.state_dict())))
assert set(again.tracks().identity.tolist()) == set(tracker.tracks().identity.tolist()) == {1, 2}
print(len(rows), len(final.rest()))
"""
# The order of the boxes changes from frame to frame: whose identity is whose is said by nothing but
# the detection.
PEERS = """
import numpy as np
import supervision as sv
from phdtrack import Tracker
from trackers import ByteTrackTracker, SORTTracker

ours = Tracker(frame_size=(640, 360), fps=25)
after = Tracker(frame_size=(640, 360), fps=25)
sort = SORTTracker()
peers, given = [SORTTracker(), ByteTrackTracker()], [set(), set(), set()]
for k in range(30):
    one = [100 + 4 * k, 100, 140 + 4 * k, 200]
    other = [400 - 3 * k, 120, 445 - 3 * k, 230]
    boxes = np.array([one, other], np.float32)
    who = np.roll([0, 1], k)
    known = {"confidence": np.array([0.9, 0.8]), "class_id": np.zeros(2, int)}
    found = sv.Detections(boxes[who], data={"who": who}, **known)
    rows = ours.update(found)
    seen = rows[~rows.predicted]
    mine = found[seen.detection]
    mine.tracker_id = seen.identity
    theirs = [peer.update(found) for peer in peers]
    chained, back = after.update(theirs[0]), sort.update(rows.to_supervision())
    if k < 10:
        continue
    for pairs, out in zip(given, [mine, *theirs]):
        assert np.array_equal(boxes[out.data["who"]], out.xyxy), k
        pairs |= {*zip(out.data["who"].tolist(), out.tracker_id.tolist())}
    sorted_rows = np.sort(rows.xyxy.astype(np.float32), axis=0)
    assert len(chained) == 2 and np.array_equal(np.sort(back.xyxy, axis=0), sorted_rows), k
    assert (back.tracker_id >= 0).all(), k
    assert back.data["detection"].tolist() == rows.detection.tolist(), k
for pairs in given:
    assert [*map(len, map(set, zip(*pairs)))] == [2, 2] and len(pairs) == 2, given
print(given)
"""
# The OpenCV of an environment, which may lack a library that it needs: its version, and a hash of
# its files.
OPENCV_FILES = """
import hashlib
from importlib.util import find_spec
from pathlib import Path

folder = Path(find_spec("cv2").origin).parent
files = sorted(one for one in folder.rglob("*") if one.is_file() and one.suffix != ".pyc")
digest = hashlib.sha256()
for file in files:
    digest.update(str(file).encode() + file.read_bytes())
print((folder / "version.py").read_text(), len(files), digest.hexdigest())
"""
# What the program of the README uses of ultralytics; its networks would be fetched.
ULTRALYTICS = """
from types import SimpleNamespace

import numpy as np

class YOLO:
    def __init__(self, weights):
        assert weights == "yolo11n.pt"

    def __call__(self, source, stream, conf):
        assert source == "video.mp4" and stream and 0 < conf < 0.2
        for k in range(30):
            xyxy = np.array([[100 + 4 * k, 100, 140 + 4 * k, 200]], np.float32)
            boxes = SimpleNamespace(xyxy=xyxy, conf=np.array([0.9]), cls=np.zeros(1))
            yield SimpleNamespace(orig_shape=(360, 640), boxes=boxes, obb=None)
"""
REPORTS = "phdtrack[report]"
VIDEOS = "phdtrack[video]"
PAGES = "phdtrack[web]"
OPENCV = "phdtrack[opencv]"


def test_a_tracker_needs_none_of_the_extras() -> None:
    program = (
        WITHOUT.format(absent={*EXTRAS, "jinja2", "markupsafe", "typer", "click", "rich"}) + LOOP
    )
    printed = finished(program).stdout.split()
    assert [int(word) > 0 for word in printed] == [True, True]


def forget(monkeypatch: pytest.MonkeyPatch, absent: Iterable[str]) -> None:
    """Nothing can import these packages, nor what imports them when it is loaded."""
    for name in {*absent, *(name for name in sys.modules if name.partition(".")[0] in absent)}:
        monkeypatch.setitem(sys.modules, name, None)
    vars(opencv_package.cv2).clear()
    pages = ("phdtrack.live.live_page", "phdtrack.label.label_page")
    for name in (*pages, *(name for name in sys.modules if name.startswith("phdtrack.web"))):
        monkeypatch.delitem(sys.modules, name, raising=False)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small sequence with images, and a file that calls itself a video."""
    folder = walkers(tmp_path_factory.mktemp("core") / "walkers", frames=5)
    (folder / "img1").mkdir()
    for k in range(1, 6):
        cv2.imwrite(str(folder / "img1" / f"{k:06d}.png"), np.full((240, 320, 3), 90, np.uint8))
    (folder / "video.mp4").write_bytes(b"nobody gets as far as this")
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["settings"],
        ["learn", "--detections", "det/det.txt", "--clutter", "unattended", "--out", "scene.json"],
        ["evaluate", "--truth", "gt/gt.txt", "--tracks", "gt/gt.txt"],
        ["export", "gt/gt.txt", "--to", "csv", "--out", "tracks.csv"],
        ["warm-up"],
    ],
    ids=lambda words: words[0],
)
def test_what_the_core_can_do_alone(
    words: list[str], sequence: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forget(monkeypatch, EXTRAS)
    monkeypatch.chdir(sequence)
    said = phdtrack(*words)
    assert said.status == 0, said


@pytest.mark.parametrize(
    ("words", "absent", "package"),
    [
        (["track", "video.mp4"], "av", VIDEOS),
        (["track", "img1"], "av", VIDEOS),
        (["live", "video.mp4", "--no-page"], "av", VIDEOS),
        (["simulate", "street", "--frames", "3"], "av", VIDEOS),
        (["track", "--detections", "det/det.txt"], "matplotlib", REPORTS),
        (["track", "--detections", "det/det.txt"], "cv2", OPENCV),
        (["track", "img1"], "cv2", OPENCV),
        (["detect", "img1", "--out", "found", "--detector", "mog2"], "cv2", OPENCV),
        (["live", "video.mp4", "--no-page"], "cv2", OPENCV),
        (["simulate", "street", "--frames", "3"], "cv2", OPENCV),
        (["demo"], "cv2", OPENCV),
        (["compare", "."], "matplotlib", REPORTS),
        (["demo"], "matplotlib", REPORTS),
        (["live", "video.mp4"], "uvicorn", PAGES),
        (["label", "video.mp4"], "starlette", PAGES),
        (
            ["live", "video.mp4", "--no-page", "--mqtt", "mqtt://localhost"],
            "paho",
            "phdtrack[mqtt]",
        ),
        (["track", "img1", "--detector", "onnx:net.onnx"], "onnxruntime", "phdtrack[onnx]"),
        (
            ["export", "gt/gt.txt", "--to", "parquet", "--out", "tracks.parquet"],
            "pyarrow",
            "phdtrack[parquet]",
        ),
    ],
    ids=lambda value: " ".join(value[:1]) if isinstance(value, list) else value,
)
def test_a_missing_extra_is_named_at_once(
    words: list[str], absent: str, package: str, sequence: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forget(monkeypatch, [absent])
    monkeypatch.chdir(sequence)
    assert refused(*words).endswith(f": this needs the package {absent}. pip install '{package}'")
    assert not (sequence / "runs").exists() or not [*(sequence / "runs").rglob("*.csv")]


def test_every_optional_package_is_in_an_extra() -> None:
    extras = PROJECT["optional-dependencies"]
    named = {"paho": "paho-mqtt", "cv2": "opencv-python-headless"}
    for module, package in EXTRAS.items():
        extra = re.fullmatch(r"phdtrack\[(\w+)\]", package)[1]
        assert any(one.startswith(named.get(module, module)) for one in extras[extra]), module
        assert not any(
            one.startswith(named.get(module, module)) for one in PROJECT["dependencies"]
        ), module
    (everything,) = extras["all"]
    assert set(re.findall(r"\w+", everything)) - {"phdtrack"} == set(extras) - {
        "all",
        "dev",
        "opencv",
        "ray",
    }


def test_the_dockerfile_names_what_there_is() -> None:
    """Paths, extras, commands and programs: nobody builds it here."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    steps = [
        line.split(maxsplit=1) for line in text.splitlines() if line and not line.startswith("#")
    ]
    assert {name for name, _ in steps} <= {
        "FROM",
        "WORKDIR",
        "COPY",
        "RUN",
        "ENV",
        "USER",
        "EXPOSE",
        "ENTRYPOINT",
        "CMD",
    }
    assert steps[0][0] == "FROM"
    python = re.fullmatch(r"python:(\d+)\.(\d+)-slim", steps[0][1])
    assert (int(python[1]), int(python[2])) >= tuple(
        map(int, PROJECT["requires-python"].removeprefix(">=").split("."))
    )
    copied = {path for name, rest in steps if name == "COPY" for path in rest.split()[:-1]}
    assert all((ROOT / path).exists() for path in copied)
    # What building the wheel reads.
    assert {"pyproject.toml", PROJECT["readme"], *PROJECT["license-files"], "src"} <= copied
    said = " ".join(rest for name, rest in steps if name == "RUN")
    assert (
        set(re.search(r"\.\[([\w,]+)\]", said)[1].split(","))
        == {"all", "opencv"}
        <= set(PROJECT["optional-dependencies"])
    )
    # Kernels are kept in a folder that every user can write into.
    assert re.findall(r"(?<![\w/])phdtrack ([a-z-]+)", said) == ["warm-up"]
    assert "warm-up" in COMMANDS
    kept = dict(rest.split("=", 1) for name, rest in steps if name == "ENV")["NUMBA_CACHE_DIR"]
    assert f"chmod -R a+rwX {kept}" in said
    entry = json.loads(dict(steps)["ENTRYPOINT"])
    assert entry[0] in PROJECT["scripts"]
    shown = re.search(r"docker run .* phdtrack (\w+)", text)
    assert shown[1] in COMMANDS


PIP = [sys.executable, "-m", "pip"]


class Alone(NamedTuple):
    """An environment of its own, in a folder of its own."""

    python: Path
    folder: Path

    def install(self, *what: str) -> None:
        """Fetch packages; the test is skipped where that cannot be done."""
        command = [*PIP, "--python", str(self.python), "install", "--quiet", *what]
        done = subprocess.run(command, capture_output=True, text=True, timeout=900)
        if done.returncode and re.search(
            "connection|timed out|no matching distribution", done.stderr, re.IGNORECASE
        ):
            pytest.skip(f"packages cannot be fetched here: {done.stderr.strip().splitlines()[-1]}")
        assert done.returncode == 0, done.stderr

    def uninstall(self, package: str) -> None:
        """Take a package away."""
        command = [*PIP, "--python", str(self.python), "uninstall", "--quiet", "--yes", package]
        subprocess.run(command, check=True, capture_output=True, timeout=300)

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        clean = {
            name: value
            for name, value in os.environ.items()
            if name not in ("PYTHONPATH", "NUMBA_CACHE_DIR")
        }
        command = [str(self.python), *words]
        return subprocess.run(
            command, capture_output=True, text=True, cwd=self.folder, env=clean, timeout=600
        )


def finished_alone(alone: Alone, *words: str) -> str:
    """What a program prints that runs in the environment to its end."""
    done = alone.run(*words)
    assert done.returncode == 0, (words, done.stderr)
    return done.stdout


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Alone:
    """Nothing but the wheel of phdtrack and what it asks for."""
    folder = tmp_path_factory.mktemp("alone")
    build = [
        *PIP,
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--wheel-dir",
        str(folder),
        str(ROOT),
    ]
    subprocess.run(build, check=True, timeout=300, capture_output=True)
    venv.create(folder / "env", with_pip=False)
    found = Alone(folder / "env" / ("Scripts" if os.name == "nt" else "bin") / "python", folder)
    found.install(*map(str, folder.glob("*.whl")))
    return found


def test_a_wheel_alone_in_an_empty_environment_tracks(alone: Alone) -> None:
    done = alone.run("-c", LOOP)
    assert done.returncode == 0, done.stderr
    assert "phdtrack compiles its kernels" in done.stderr
    for module in EXTRAS:
        assert alone.run("-c", f"import {module}").returncode == 1, module
    assert f"pip install '{REPORTS}'" in alone.run("-m", "phdtrack", "demo", "--out", "demo").stderr


@pytest.mark.parametrize(
    "package",
    [
        "opencv-python-headless",
        "opencv-python",
        "opencv-contrib-python-headless",
        "opencv-contrib-python",
    ],
)
def test_any_package_of_opencv_is_used_as_it_is(package: str, alone: Alone) -> None:
    """No extra but ``opencv`` asks for one, so that pip leaves the one that was there first."""
    asking = {name for name, what in PROJECT["optional-dependencies"].items() if "cv" in str(what)}
    assert asking == {"opencv", "dev"}
    assert "cv" not in " ".join(PROJECT["dependencies"])
    (wheel,) = alone.folder.glob("*.whl")
    alone.install(package)
    try:
        before = finished_alone(alone, "-c", OPENCV_FILES)
        alone.install(f"{wheel}[all]")
        assert finished_alone(alone, "-c", OPENCV_FILES) == before
        for words in (
            ["simulate", "street", "--frames", "20", "--out", f"street-{package}"],
            ["track", f"street-{package}/scene.mp4", "--out", f"run-{package}"],
        ):
            done = alone.run("-m", "phdtrack", *words)
            if "cannot open shared object file" in done.stderr:
                assert "--force-reinstall opencv-python-headless" in done.stderr
                pytest.skip(f"{package} cannot be loaded here: {done.stderr.strip()}")
            assert done.returncode == 0, done.stderr
        assert (alone.folder / f"run-{package}" / "annotated.mp4").stat().st_size > 1000
        assert finished_alone(alone, "-c", OPENCV_FILES) == before
    finally:
        alone.uninstall(package)


def test_the_first_blocks_of_the_readme_can_be_pasted_one_by_one(alone: Alone) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    first, loop, ultralytics, story = re.findall(
        r"^```(?:python)?\n(.*?)^```$", text, re.MULTILINE | re.DOTALL
    )
    pip, opencv, first = first.split("\n", 2)
    assert shlex.split(pip, comments=True) == ["pip", "install", ".[all]"]
    (wheel,) = alone.folder.glob("*.whl")
    alone.install(f"{wheel}[all]")
    look, _, then = opencv.partition(" || ")
    assert shlex.split(look) == ["python", "-c", "import cv2"]
    assert alone.run(*shlex.split(look)[1:]).returncode == 1
    assert shlex.split(then) == ["pip", "install", ".[opencv]"]
    alone.install(f"{wheel}[opencv]")
    assert alone.run(*shlex.split(look)[1:]).returncode == 0
    found = []
    for words in (shlex.split(line, comments=True) for line in (first + story).splitlines()):
        assert words[0] == "phdtrack", words
        done = alone.run("-m", *words)
        assert done.returncode == 0, (words, done.stderr)
        if words[1] == "track":
            objects = re.search(r"^(\d+) objects? in ", done.stdout, re.MULTILINE)[1]
            mota, idf1 = (
                re.search(rf"^{name} +0?(\.\d+) ", done.stdout, re.MULTILINE)[1]
                for name in ("MOTA", "IDF1")
            )
            said = " ".join(done.stdout.split())
            # A share that rounds to 0 is not told.
            doubtful = re.search(r"about ([\d.]+) % of the boxes are in doubtful", said)
            found.append((objects, mota, idf1, doubtful[1] if doubtful else 0.0))
    # What the story of the README says; another version of OpenCV smooths a little otherwise.
    share = int(re.search(r"(\d+) % of the boxes are doubtful", text)[1])
    said = re.findall(r"\| (\d+) \| (\.\d{3}) \| (\.\d{3}) \|$", text, re.MULTILINE)
    untaught, taught, scene = (tuple(map(float, row)) for row in found)
    assert untaught[3] == pytest.approx(share, abs=8)
    for row, other, near in zip((untaught, taught, scene), said, (0.1, 0.02, 0.05), strict=True):
        assert row[1:3] == pytest.approx(tuple(map(float, other[1:])), abs=near)
    assert taught[0] == float(said[1][0]) == 6
    assert untaught[0] > scene[0] > taught[0]
    assert re.search(r"^29 1 \[", finished_alone(alone, "-c", loop), re.MULTILINE)
    (alone.folder / "ultralytics.py").write_text(ULTRALYTICS, encoding="utf-8")
    printed = finished_alone(alone, "-c", ultralytics)
    assert len(re.findall(r"^1 \[", printed, re.MULTILINE)) > 20, printed


def test_loops_of_other_packages_run_with_them(
    alone: Alone,
) -> None:
    """But for networks, which would fetch their weights. Norfair itself asks for NumPy 1: a fork
    has the same names.
    """
    alone.install("supervision", "norfair-enough")
    page = (
        (ROOT / "docs" / "how-to" / "from-other-trackers.md")
        .read_text(encoding="utf-8")
        .partition("## Ultralytics")[0]
    )
    programs = ""
    for program in re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL):
        programs += f"{program}\nassert set(tracker.tracks().identity.tolist()) == {{1, 2}}\n"
    (alone.folder / "loops.py").write_text(programs, encoding="utf-8")
    done = alone.run("-c", "import loops")
    assert done.returncode == 0, done.stderr


def test_trackers_and_phdtrack_exchange_detections(alone: Alone) -> None:
    alone.install("supervision")
    pinned = (ROOT / "benchmarks" / "peers-constraints.txt").read_text(encoding="utf-8")
    # What it asks for beside these would put another OpenCV in place.
    alone.install(
        "--no-deps",
        *re.findall(r"^(?:trackers|pyDeprecate|rich|requests)==\S+", pinned, re.MULTILINE),
    )
    done = alone.run("-c", PEERS)
    assert done.returncode == 0, done.stderr
