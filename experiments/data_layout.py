"""Bring downloads of the published sets into the layout that the experiments expect.

``python -m experiments data --from DOWNLOADS`` looks in a folder of unpacked downloads. A file that
is one of `data_files.csv` bit by bit is copied to its place, whatever its name. `RECIPES` make the
others of the files that are published. Files that are there already stay as they are.
"""

from __future__ import annotations

import math
import shutil
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from phdtrack.errors import InputError
from phdtrack.files import write_text
from phdtrack.types import SequenceInfo

Convert = Callable[[str], Mapping[str, str]]
# Files of the list are smaller; others need no checksum.
_LARGEST = 100_000_000
# Classes of MOT17 and MOT20: who counts, and what neither counts nor is false.
_PEDESTRIAN = "1"
_IGNORED = ("2", "7", "8", "12")
TRUTH = "gt/gt.txt"
IGNORED = "gt/ignore.txt"
SEQINFO = "seqinfo.ini"


class Recipe(NamedTuple):
    """How files of a sequence are made of one that is published.

    Attributes
    ----------
    folder : of the sequence.
    source : end of the path of the published file; may have patterns.
    convert : its text to the files of the folder, by name.
    """

    folder: str
    source: str
    convert: Convert


class Box(NamedTuple):
    """A row of a file: ``sides`` are left, top, width and height as text."""

    frame: int
    identity: int
    sides: tuple[str, ...]


def boxes_text(boxes: Iterable[Box], flag: int) -> str:
    """Rows of MOT15's ten columns, by frame and identity.

    Parameters
    ----------
    boxes : in any order.
    flag : 1: they count; 0: they do not.
    """
    ordered = sorted(boxes, key=lambda one: one[:2])
    return "".join(
        f"{one.frame},{one.identity},{','.join(one.sides)},{flag},-1,-1,-1\n" for one in ordered
    )


def words_of(text: str, separator: str | None = ",") -> list[list[str]]:
    """The columns of each line that is not blank."""
    lines = [line for line in text.splitlines() if line.strip()]
    return [[word.strip() for word in line.split(separator)] for line in lines]


def later_half(text: str, before: int) -> dict[str, str]:
    """The truth of the last frames of a sequence of MOT17 or MOT20.

    Parameters
    ----------
    text : the published gt.txt.
    before : frames to leave out; the next one becomes frame 1.
    """
    counted = list[Box]()
    ignored = list[Box]()
    for row in words_of(text):
        box = Box(int(row[0]) - before, int(row[1]), tuple(row[2:6]))
        if box.frame < 1:
            continue
        if row[7] == _PEDESTRIAN and row[6] != "0":
            counted.append(box)
        elif row[7] in _IGNORED:
            ignored.append(box)
    if not counted:
        raise InputError(f"expected frames after {before}, got none")
    return {TRUTH: boxes_text(counted, 1), IGNORED: boxes_text(ignored, 0)}


def everybody(text: str) -> dict[str, str]:
    """The truth of DanceTrack and SportsMOT, whose identities count from 0.

    Parameters
    ----------
    text : the published gt.txt.
    """
    rows = words_of(text)
    boxes = [Box(int(row[0]), int(row[1]) + 1, tuple(row[2:6])) for row in rows]
    return {TRUTH: boxes_text(boxes, 1), IGNORED: ""}


def kitti_truth(text: str, kinds: Sequence[str]) -> dict[str, str]:
    """The truth of a KITTI label file, whose frames and identities count from 0.

    Parameters
    ----------
    text : the published file.
    kinds : the type that counts, if it is not cut off and is not largely or wholly hidden, and
        types that resemble it, which are ignored.
    """
    counted = list[Box]()
    ignored = list[Box]()
    for row in words_of(text, None):
        left, top, right, bottom = map(float, row[6:10])
        sides = tuple(decimals(side) for side in (left, top, right - left, bottom - top))
        frame = int(row[0]) + 1
        if row[2] == "DontCare":
            ignored.append(Box(frame, -1, sides))
        elif row[2] == kinds[0] and row[3] == "0" and row[4] in ("0", "1", "2"):
            counted.append(Box(frame, int(row[1]) + 1, sides))
        elif row[2] in kinds:
            ignored.append(Box(frame, int(row[1]) + 1, sides))
    return {TRUTH: boxes_text(counted, 1), IGNORED: boxes_text(ignored, 0)}


class Columns(NamedTuple):
    """The columns of a published file of detections.

    Attributes
    ----------
    box : the first of four columns of the box; the score follows.
    corners : True: right and bottom in place of width and height.
    first : number of the first frame.
    """

    box: int
    corners: bool
    first: int


MOT_COLUMNS = Columns(2, corners=False, first=1)
RRC_COLUMNS = Columns(1, corners=True, first=0)
POINTRCNN_COLUMNS = Columns(2, corners=True, first=0)


def detections(
    text: str, name: str, columns: Columns, before: int = 0, least: float = -math.inf
) -> dict[str, str]:
    """Detections in MOT15's columns, of each frame the highest score first.

    Parameters
    ----------
    text : the published file.
    name : of the detector.
    columns : where what is.
    before : frames to leave out; the next one becomes frame 1.
    least : lower scores are left out.
    """
    rows = list[tuple[int, list[float]]]()
    for row in words_of(text):
        number = int(row[0]) + 1 - columns.first - before
        values = [float(word) for word in row[columns.box : columns.box + 5]]
        if columns.corners:
            values[2] -= values[0]
            values[3] -= values[1]
        if number >= 1 and values[4] >= least:
            rows.append((number, values))
    rows.sort(key=lambda one: (one[0], -one[1][4]))
    lines = [
        f"{number},-1,{','.join(map(decimals, values[:4]))},{values[4]:.4g},-1,-1,-1\n"
        for number, values in rows
    ]
    return {f"det_{name}/det.txt": "".join(lines)}


def camera_motion(text: str, before: int = 0) -> dict[str, str]:
    """The camera's motion, of a file with a frame from 0 and six numbers a line.

    Parameters
    ----------
    text : the published file.
    before : frames to leave out; the next one becomes frame 1.
    """
    lines = []
    for row in words_of(text, None):
        number = int(row[0]) + 1 - before
        if number >= 1:
            values = ",".join(f"{float(word):.6g}" for word in row[1:7])
            lines.append(f"{number},{values}\n")
    return {"gmc.txt": "".join(lines)}


def decimals(value: float) -> str:
    """A number with at most two decimals."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def seqinfo(name: str, info: SequenceInfo, end: str = "") -> str:
    """The text of a seqinfo.ini.

    Parameters
    ----------
    name : of the sequence.
    info : its size, rate and length.
    end : what follows the last line.
    """
    return (
        f"[Sequence]\nname={name}\nimDir=img1\nframeRate={info.fps:g}\nseqLength={info.frames}\n"
        f"imWidth={info.width}\nimHeight={info.height}\nimExt=.jpg\n{end}"
    )


# Frames of the first half, which is left out.
HALVES = {"MOT17-09": 263, "MOT17-11": 451, "MOT20-01": 215}
DANCERS = ("0005", "0018", "0026", "0065", "0081")
# The published name of each sequence of SportsMOT, all from its validation part.
SPORTS = {
    "basketball-1": "v_4r8QL_wglzQ_c001",
    "football-1": "v_dw7LOz17Omg_c053",
    "volleyball-1": "v_9MHDmAMxO5I_c009",
}
CARS = ("0000", "0001", "0003", "0005", "0007", "0009", "0011", "0014")
WALKERS = ("0015",)


def _recipes() -> list[Recipe]:
    """The recipes of all sets that are made of published files."""
    out = []
    for name, before in HALVES.items():
        folder = f"more/{name}"
        kind = name[:5].lower()
        found = f"yolox_x_ablation/{name}-SDP.txt"
        truth = f"{name}-*/gt/gt.txt"
        if kind == "mot20":
            found = f"det_results/mot20/val/{name}.txt"
            truth = f"{name}/gt/gt.txt"
        yolox = partial(detections, name="yolox", columns=MOT_COLUMNS, before=before, least=0.05)
        moved = partial(camera_motion, before=before)
        out += [
            Recipe(folder, truth, partial(later_half, before=before)),
            Recipe(folder, found, yolox),
            Recipe(folder, f"gmc/{kind}/GMC-{name}.txt", moved),
        ]
    for number in DANCERS:
        name = f"dancetrack{number}"
        yolox = partial(detections, name="yolox", columns=MOT_COLUMNS)
        out += [
            Recipe(f"more/{name}", f"{name}/gt/gt.txt", everybody),
            Recipe(f"more/{name}", f"det_results/dance/val/{name}.txt", yolox),
            Recipe(f"more/{name}", f"gmc/dance/GMC-{name}.txt", camera_motion),
        ]
    out += [Recipe(f"more/{name}", f"{own}/gt/gt.txt", everybody) for name, own in SPORTS.items()]
    for number in CARS:
        out += _kitti(number, "car", ("Car", "Van"))
    for number in WALKERS:
        out += _kitti(number, "ped", ("Pedestrian", "Person"))
    return out


def _kitti(number: str, short: str, kinds: Sequence[str]) -> list[Recipe]:
    """The recipes of a sequence of KITTI."""
    folder = f"more/KITTI-{number}-{short}"
    rrc = partial(detections, name="rrc", columns=RRC_COLUMNS)
    pointrcnn = partial(detections, name="pointrcnn", columns=POINTRCNN_COLUMNS)
    return [
        Recipe(folder, f"label_02/{number}.txt", partial(kitti_truth, kinds=kinds)),
        Recipe(folder, f"rrc/training/{kinds[0]}/{number}.txt", rrc),
        Recipe(folder, f"pointrcnn_{kinds[0]}_val/{number}.txt", pointrcnn),
        Recipe(folder, f"gmc/kitti/train/GMC-{number}.txt", camera_motion),
    ]


def _infos() -> dict[str, str]:
    """The text of seqinfo.ini of each sequence whose truth is published without one that fits."""
    full = (1920, 1080)
    table = {
        "MOT17-09": (*full, 30, 262),
        "MOT17-11": (*full, 30, 449),
        "MOT20-01": (*full, 25, 214),
        "dancetrack0005": (*full, 20, 1203),
        "dancetrack0018": (*full, 20, 503),
        "dancetrack0026": (1280, 720, 20, 302),
        "dancetrack0065": (*full, 20, 702),
        "dancetrack0081": (1280, 720, 20, 984),
        "basketball-1": (1280, 720, 25, 886),
        "football-1": (1280, 720, 25, 550),
        "volleyball-1": (1280, 720, 25, 507),
        "KITTI-0000-car": (1242, 375, 10, 154),
        "KITTI-0001-car": (1242, 375, 10, 447),
        "KITTI-0003-car": (1242, 375, 10, 144),
        "KITTI-0005-car": (1242, 375, 10, 297),
        "KITTI-0007-car": (1242, 375, 10, 800),
        "KITTI-0009-car": (1242, 375, 10, 803),
        "KITTI-0011-car": (1242, 375, 10, 373),
        "KITTI-0014-car": (1224, 370, 10, 106),
        "KITTI-0015-ped": (1224, 370, 10, 376),
    }
    old = {
        "ADL-Rundle-6": (*full, 30, 525),
        "ETH-Sunnyday": (640, 480, 14, 354),
        "KITTI-17": (1224, 370, 10, 145),
        "PETS09-S2L1": (768, 576, 7, 795),
        "TUD-Campus": (640, 480, 25, 71),
    }
    texts = {f"more/{name}": seqinfo(name, SequenceInfo(*one)) for name, one in table.items()}
    # Those of MOT15 end in a blank line.
    return texts | {
        f"mot15/{name}": seqinfo(name, SequenceInfo(*one), "\n") for name, one in old.items()
    }


RECIPES = tuple(_recipes())
INFOS = _infos()


class Brought(NamedTuple):
    """What was done: the source of each new file, by its name, and sentences about files that
    could not be used, by the folder of the sequence.
    """

    source: dict[str, str]
    problems: Mapping[str, list[str]]


def bring(
    downloads: Path,
    place: Path,
    expected: Mapping[str, str],
    checksum: Callable[[Path], str],
    recipes: Sequence[Recipe] = RECIPES,
) -> Brought:
    """Copy or make the expected files that are missing, of those in ``downloads``.

    Raises `InputError` if that is no folder, or is the place itself.

    Parameters
    ----------
    downloads : folder of unpacked downloads, of any depth.
    place : folder of the data.
    expected : the checksum of each file, by its name below ``place``.
    checksum : of a file, as those that are expected.
    recipes : how files are made.
    """
    if not downloads.is_dir():
        raise InputError("expected a folder of unpacked downloads", where=downloads)
    if downloads.resolve() == place.resolve():
        raise InputError(
            "expected another folder than that of the data",
            where=downloads,
            cure="PHDTRACK_DATA names the folder of the data.",
        )
    brought = Brought({}, defaultdict(list))
    suffixes = {PurePosixPath(name).suffix.lower() for name in expected}
    found = [
        file
        for file in sorted(downloads.rglob("*"))
        if file.suffix.lower() in suffixes and file.is_file()
    ]
    _copy(found, place, expected, checksum, brought)
    for recipe in recipes:
        _make(recipe, found, place, expected, checksum, brought)
    for folder, text in INFOS.items():
        name = f"{folder}/{SEQINFO}"
        wanted = name in expected and not (place / name).exists()
        if wanted and (place / folder / TRUTH).exists():
            write_text(place / name, text)
            brought.source[name] = "the table of sequences"
    return brought


def _copy(
    found: Sequence[Path],
    place: Path,
    expected: Mapping[str, str],
    checksum: Callable[[Path], str],
    brought: Brought,
) -> None:
    """Copy the files that are expected as they are."""
    missing = defaultdict[str, list[str]](list)
    for name, one in expected.items():
        if not (place / name).exists():
            missing[one].append(name)
    for file in found:
        size = file.stat().st_size
        if not missing or not 0 < size < _LARGEST:
            continue
        for name in missing.pop(checksum(file), ()):
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, place / name)
            brought.source[name] = str(file)


def _make(
    recipe: Recipe,
    found: Sequence[Path],
    place: Path,
    expected: Mapping[str, str],
    checksum: Callable[[Path], str],
    brought: Brought,
) -> None:
    """Follow a recipe. If several files fit, the first counts from which the expected ones come."""
    for file in found:
        if not file.match(recipe.source):
            continue
        try:
            made = recipe.convert(file.read_text(encoding="utf-8"))
        except InputError as error:
            brought.problems[recipe.folder].append(f"{file}: {error}")
            continue
        except (ValueError, IndexError):
            brought.problems[recipe.folder].append(f"{file}: the columns are not as published")
            continue
        right = True
        for part, text in made.items():
            name = f"{recipe.folder}/{part}"
            if name not in brought.source and (place / name).exists():
                continue
            write_text(place / name, text)
            brought.source[name] = str(file)
            right &= expected.get(name) == checksum(place / name)
        if right:
            return
