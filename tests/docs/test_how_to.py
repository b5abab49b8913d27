"""The pages of docs/how-to do what they say: their commands and programs are run, in order, on the
scene that they make, with fewer frames.
"""

from __future__ import annotations

import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import duckdb
import numpy as np
import pytest
from typer.testing import CliRunner

import networks
from experiments import __main__ as experiments
from phdtrack.cli.app import application

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "how-to"
NAMES = sorted(page.name for page in PAGES.glob("*.md"))
LOOPS = "from-other-trackers.md"
TOML_NAME = re.compile(r"# (\w+\.toml)\n")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# The scene of the pages, and what makes a shorter one of it.
STREET = "phdtrack simulate street --out street"
SHORTER = " --seed 1 --frames 30 --set lead_in=-6"


class Block(NamedTuple):
    language: str
    text: str
    line: int


def blocks(page: str) -> list[Block]:
    text = (PAGES / page).read_text(encoding="utf-8")
    return [Block(m[1], m[2], text.count("\n", 0, m.start()) + 1) for m in BLOCK.finditer(text)]


def command(line: str) -> None:
    words = shlex.split(line)
    if words[:3] == ["python", "-m", "experiments"]:
        assert experiments.main(words[3:]) == 0, line
        return
    assert words[0] == "phdtrack", line
    result = CliRunner().invoke(application(words[1]), words[1:])
    assert result.exit_code == 0, (line, result.stderr, result.exception)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """NETWORK.onnx, which finds blobs, and EMBEDDINGS.onnx, which describes crops: the user's own
    files. All others are made by the pages.
    """
    folder = tmp_path_factory.mktemp("scene")
    networks.write(
        folder / "NETWORK.onnx",
        shape=("N", 3, 320, 320),
        metadata={"names": "['person', 'car', 'bus']"},
    )
    networks.write_embeddings(folder / "EMBEDDINGS.onnx")
    return folder


@pytest.fixture(scope="module")
def written() -> dict[Path, str]:
    """The page that wrote a file, for who follows all pages in one folder."""
    return {}


class Boxes:
    """What `supervision.Detections` is in a loop: arrays of one length that are indexed
    together.
    """

    def __init__(self, xyxy: Any, data: Any = None, **known: Any) -> None:
        self.xyxy = xyxy
        self.data = data
        self.known = known

    def __getattr__(self, name: str) -> Any:
        return self.__dict__.get("known", {}).get(name)

    def __getitem__(self, index: Any) -> Boxes:
        return Boxes(self.xyxy[index], **{name: value[index] for name, value in self.known.items()})


def network(frames: Iterator[int]) -> np.ndarray:
    """(3, 6) two people and a car in the next of the frames: corners, score, class 1 or 3."""
    k = next(frames)
    people = [
        [100 + 4 * k, 100, 140 + 4 * k, 200, 0.9, 1],
        [400 - 3 * k, 120, 445 - 3 * k, 230, 0.8, 1],
    ]
    return np.array([*people, [300 + 2 * k, 260, 400 + 2 * k, 320, 0.7, 3]])


class Yolo:
    """A model of ultralytics: results with the size of the frame, height first, and `boxes`, which
    have `xyxy`, `conf` and `cls`.
    """

    def __init__(self, file: str) -> None:
        assert file.endswith(".pt")

    def __call__(self, source: str, *, stream: bool, conf: float) -> Iterator[SimpleNamespace]:
        assert Path(source).exists()
        frames = count()
        for _ in range(30):
            found = network(frames)
            people = found[found[:, 5] == 1]
            yield SimpleNamespace(
                orig_shape=(360, 640),
                boxes=SimpleNamespace(xyxy=people[:, :4], conf=people[:, 4], cls=people[:, 5]),
                obb=None,
            )


class FasterRcnn:
    """A detector of torchvision: for each image boxes, scores and labels."""

    def __init__(self, weights: str) -> None:
        self.frames = count()

    def eval(self) -> FasterRcnn:
        return self

    def __call__(self, images: list[Any]) -> list[dict[str, np.ndarray]]:
        assert images[0].shape[2] == 3
        found = network(self.frames)
        return [
            {"boxes": found[:, :4], "scores": found[:, 4], "labels": found[:, 5].astype(np.int64)}
        ]


# What loops with other packages use of them. Those with networks are never run for real: they would
# fetch weights.
STAND_INS: dict[str, dict[str, Any]] = {
    "supervision": {"Detections": Boxes},
    "norfair": {"Detection": SimpleNamespace},
    "ultralytics": {"YOLO": Yolo},
    "torch": {"column_stack": np.column_stack, "inference_mode": nullcontext},
    "torchvision": {},
    "torchvision.models": {},
    "torchvision.models.detection": {"fasterrcnn_mobilenet_v3_large_fpn": FasterRcnn},
    "torchvision.transforms": {},
    "torchvision.transforms.functional": {"to_tensor": np.asarray},
}
REAL = ("supervision", "norfair")


def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let programs import the stand-ins, except for packages that are installed and real."""
    for name, members in STAND_INS.items():
        if name not in REAL or find_spec(name) is None:
            module = ModuleType(name)
            module.__dict__.update(members)
            monkeypatch.setitem(sys.modules, name, module)


@pytest.mark.slow
@pytest.mark.parametrize("page", NAMES)
def test_commands_and_programs_of_a_page_run(
    page: str,
    scene: Path,
    written: dict[Path, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stand_in(monkeypatch)
    work = tmp_path / "work"
    shutil.copytree(scene, work)
    monkeypatch.chdir(work)
    names: dict[str, Any] = {"__name__": "page"}
    for block in blocks(page):
        match block.language:
            case "toml":
                (work / TOML_NAME.match(block.text)[1]).write_text(block.text, encoding="utf-8")
            case "sh":
                for line in block.text.splitlines():
                    command(line + SHORTER * (line == STREET))
            case "sql":
                # What they should give is in test_cli_batch.py.
                duckdb.sql(block.text).fetchall()
            case "python":
                exec(compile("\n" * block.line + block.text, str(PAGES / page), "exec"), names)
                if page == LOOPS:
                    assert set(names["tracker"].tracks().identity.tolist()) == {1, 2}, (
                        f"{page}, line {block.line}"
                    )
            case other:
                pytest.fail(f"{page}, line {block.line}: blocks of {other} are not run")
    given = {path.relative_to(scene) for path in scene.rglob("*")}
    for path in {path.relative_to(work) for path in work.rglob("*") if path.is_file()} - given:
        if path.parts[0] == "street":
            # The one scene of all pages.
            continue
        assert written.setdefault(path, page) == page, (
            f"{page} and {written[path]} both write {path}"
        )


def test_pages_have_something_to_run_and_are_listed() -> None:
    index = (PAGES / "README.md").read_text(encoding="utf-8")
    for name in NAMES:
        if name != "README.md":
            assert f"({name})" in index
            assert any(block.language in ("sh", "python") for block in blocks(name)), name
    links = re.findall(r"\]\(([^):]+\.md)\)", index)
    assert all((PAGES / link).is_file() for link in links)


def programs(page: str) -> list[str]:
    """The programs on a page of the project."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [m[2] for m in BLOCK.finditer(text) if m[1] == "python"]


@pytest.mark.parametrize("page", ["docs/architecture.md", "docs/api/setting-types.md"])
def test_programs_of_the_front_pages_run(page: str) -> None:
    names = {"__name__": "__main__"}
    assert programs(page)
    for program in programs(page):
        exec(compile(program, page, "exec"), names)


@pytest.mark.parametrize(("number", "objects"), [(0, 1), (1, 2)])
def test_each_program_of_the_readme_runs_alone(
    number: int,
    objects: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It is pasted into a file of its own, beside a video."""
    stand_in(monkeypatch)
    monkeypatch.chdir(tmp_path)
    Path("video.mp4").touch()
    found = programs("README.md")
    assert len(found) == 2
    exec(compile(found[number], "README.md", "exec"), {"__name__": "__main__"})
    printed = re.findall(r"(\d+) \[ *[\d.-]+(?: +[\d.-]+){3}\]", capsys.readouterr().out)
    assert len(printed) > 20 * objects
    assert set(printed) == {str(k + 1) for k in range(objects)}


@pytest.mark.parametrize(
    "page", ["README.md", "CONTRIBUTING.md", "docs/architecture.md", "docs/security.md"]
)
def test_links_of_the_front_pages_exist(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^):#]+)\)", text):
        assert ((ROOT / page).parent / link).exists(), link


def test_architecture_lists_every_package() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    packages = {path.parent.name for path in (ROOT / "src" / "phdtrack").glob("*/__init__.py")}
    assert {name for name in packages if f"| `{name}` |" not in text} == set()
