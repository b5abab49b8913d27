"""Sources and checksums of the real sequences of the experiments.

``python -m experiments data`` lists the sets: what is missing, what differs from the files that the
pages were made with, and where each set is published. Nothing is downloaded: most licences ask that
you fetch the data yourself. ``--from DOWNLOADS`` brings what you fetched into the layout that the
experiments expect, ``--write`` makes the list of checksums anew from the folder of the data.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import sys
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

from experiments.common import data_place
from experiments.data_layout import bring
from phdtrack.errors import InputError

LIST = Path(__file__).with_name("data_files.csv")
# Hexadecimal digits of a checksum, of SHA-256.
_DIGITS = 16


class Source(NamedTuple):
    """A published set: its folder, what it is, where it is, and how it may be used."""

    folder: str
    what: str
    address: str
    licence: str


SOURCES = (
    Source(
        "mot15",
        "pedestrians of 2D MOT 2015: truth, public detections; those of Faster R-CNN from the SORT"
        " repository",
        "https://motchallenge.net/data/MOT15/",
        "CC BY-NC-SA 3.0",
    ),
    Source(
        "pets2009",
        "PETS 2009, S1.L1, view 1, with its camera; truth by A. Milan",
        "http://www.cvg.reading.ac.uk/PETS2009/a.html",
        "academic and industrial research",
    ),
    Source(
        "caviar",
        "CAVIAR, OneLeaveShop1cor, with its truth and homography",
        "https://homepages.inf.ed.ac.uk/rbf/CAVIARDATA1/",
        "research, with credit (EC project IST 2001 37540)",
    ),
    Source(
        "groups",
        "pedestrians from above with annotated groups: ETH (BIWI) and UCY (zara01)",
        "https://icu.ee.ethz.ch/research/datsets.html",
        "research, with credit",
    ),
    Source(
        "more/MOT17",
        "second halves of MOT17 and their detections of YOLOX and YOLOv10",
        "https://motchallenge.net/data/MOT17/",
        "CC BY-NC-SA 3.0",
    ),
    Source(
        "more/MOT20",
        "second half of MOT20-01",
        "https://motchallenge.net/data/MOT20/",
        "CC BY-NC-SA 3.0",
    ),
    Source(
        "more/dancetrack",
        "DanceTrack, validation",
        "https://dancetrack.github.io/",
        "annotations CC BY 4.0, data for research",
    ),
    Source(
        "more/KITTI",
        "KITTI tracking, with the detections RRC and PointRCNN",
        "https://www.cvlibs.net/datasets/kitti/eval_tracking.php",
        "CC BY-NC-SA 3.0",
    ),
    Source(
        "more/GOWT1",
        "Cell Tracking Challenge, Fluo-N2DH-GOWT1",
        "https://celltrackingchallenge.net/2d-datasets/",
        "free for research",
    ),
    *(
        Source(
            f"more/{name}",
            "SportsMOT; detections drawn from the truth",
            "https://github.com/MCG-NJU/SportsMOT",
            "CC BY-NC 4.0",
        )
        for name in ("basketball", "football", "volleyball")
    ),
    Source(
        "more/MDMT",
        "MDMT, drones; detections drawn from the truth",
        "https://github.com/VisDrone/Multi-Drone-Multi-Object-Detection-and-Tracking",
        "not stated",
    ),
    Source(
        "more/SDD",
        "Stanford Drone Dataset; detections drawn from the truth",
        "https://cvgl.stanford.edu/projects/uav_data/",
        "CC BY-NC-SA 3.0",
    ),
    Source(
        "video/cdnet",
        "CDnet 2014: highway, traffic",
        "http://changedetection.net/",
        "academic use, with citation",
    ),
    Source(
        "video/wallflower",
        "Wallflower: waving trees",
        "https://www.microsoft.com/en-us/research/publication/wallflower-principles-and-practice-of"
        "-background-maintenance/",
        "not stated",
    ),
    Source(
        "video",
        "videos of still cameras from public repositories; truth made by hand for these pages",
        "the README beside each video",
        "as the README says",
    ),
)


def source_of(file: str) -> Source | None:
    """The set with the longest folder that a file is in; None if it is in no set."""
    fitting = [one for one in SOURCES if file.startswith(one.folder)]
    return max(fitting, key=lambda one: len(one.folder), default=None)


def checksum(file: Path) -> str:
    """The first digits of the SHA-256 of a file."""
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()[:_DIGITS]


def files_in(folder: Path) -> list[str]:
    """The files of the data, without descriptions, relative to their folder."""
    return sorted(
        file.relative_to(folder).as_posix()
        for file in folder.rglob("*")
        if file.is_file() and file.name != "README.md"
    )


def write_list(folder: Path, path: Path = LIST) -> None:
    """Write the checksums of all files in a folder."""
    with path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(("file", "sha256"))
        writer.writerows((name, checksum(folder / name)) for name in files_in(folder))


def listed(path: Path = LIST) -> dict[str, str]:
    """The checksum of each file of the list, by its name."""
    with path.open(encoding="utf-8", newline="") as content:
        return {row["file"]: row["sha256"] for row in csv.DictReader(content)}


def compared(folder: Path, path: Path = LIST) -> list[str]:
    """A line for each set, and one for each file of it that is missing or differs."""
    expected = listed(path)
    by_source = defaultdict[Source | None, list[str]](list)
    for name in expected:
        by_source[source_of(name)].append(name)
    lines = []
    for source in SOURCES:
        names = by_source[source]
        missing = [name for name in names if not (folder / name).is_file()]
        other = [
            name
            for name in names
            if name not in missing and checksum(folder / name) != expected[name]
        ]
        state = f"{len(names) - len(missing)} of {len(names)} files"
        lines.append(f"{source.folder}: {state}. {source.what}")
        if missing or other:
            lines.append(f"  from {source.address} ({source.licence})")
        lines += [f"  missing: {folder / name}" for name in missing]
        lines += [
            f"  not the file that the pages were made with: {folder / name}" for name in other
        ]
    return lines


def brought(downloads: Path, folder: Path, path: Path = LIST) -> list[str]:
    """Bring downloads into the layout of a folder; a line for each sequence, what was done for it,
    and what it still lacks. Raises `InputError` if there are no downloads.

    Parameters
    ----------
    downloads : folder of unpacked downloads.
    folder : of the data.
    path : the list of checksums.
    """
    expected = listed(path)
    done = bring(downloads, folder, expected, checksum)
    by_sequence = defaultdict[str, list[str]](list)
    for name in expected:
        by_sequence["/".join(name.split("/")[:-1][:2])].append(name)
    lines = []
    for sequence, names in by_sequence.items():
        there = [name for name in names if (folder / name).is_file()]
        new = [name for name in names if name in done.source]
        lines.append(f"{sequence}: {len(there)} of {len(names)} files, {len(new)} of them new")
        for name in new:
            same = checksum(folder / name) == expected[name]
            word = "" if same else ", not the file that the pages were made with"
            lines.append(f"  {name.removeprefix(f'{sequence}/')} of {done.source[name]}{word}")
        lines += [f"  {problem}" for problem in done.problems.get(sequence, ())]
        lines += [
            f"  missing: {name.removeprefix(f'{sequence}/')}" for name in names if name not in there
        ]
    return lines


def main(words: list[str] | None = None) -> int:
    """Print the state of the data; 1 if anything is missing or differs, 2 for invalid input."""
    parser = argparse.ArgumentParser(prog="python -m experiments data", description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the checksums anew")
    parser.add_argument(
        "--from",
        dest="downloads",
        type=Path,
        metavar="DOWNLOADS",
        help="folder of unpacked downloads, from which missing files are copied or made;"
        " files that are there stay as they are",
    )
    folder = data_place()
    parsed = parser.parse_args(words)
    if parsed.write:
        write_list(folder)
        return 0
    print(f"In {folder} (PHDTRACK_DATA names another folder):")
    if parsed.downloads is None:
        lines = compared(folder)
        print(*lines, sep="\n")
        return int(any(line.startswith("  ") for line in lines))
    try:
        lines = brought(parsed.downloads, folder)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(*lines, "python -m experiments data says where missing files are published.", sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
