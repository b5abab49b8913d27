"""``phdtrack count`` and ``phdtrack export``: in a video, in a run, among tracks in a file; and
what is refused.
"""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli_runner import phdtrack, refused, walkers

from phdtrack.formats import EXPORTS, read_tracks
from phdtrack.live.counting import drawn
from phdtrack.live.zones import Place
from phdtrack.video import VideoWriter

# Tests look at pages.
pytestmark = pytest.mark.usefixtures("paged")

LINE = "middle=160,0,160,240"
ZONE = "left=0,0,100,0,100,240,0,240"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people who cross the middle of a video of 40 frames of 320x240, each once, in opposite
    directions.
    """
    folder = walkers(tmp_path_factory.mktemp("walkers"))
    with VideoWriter(folder / "w.mp4", 320, 240, 25) as video:
        for k in range(1, 41):
            image = np.full((240, 320, 3), 90, np.uint8)
            for x, y in ((20 + 5 * k, 60), (270 - 5 * k, 150)):
                image[y : y + 60, x : x + 24] = (40, 60, 200)
            video.write(image)
    said = phdtrack(
        *(
            "count",
            folder / "w.mp4",
            "--detections",
            folder / "det" / "det.txt",
            "--line",
            LINE,
            "--zone",
            ZONE,
        ),
        *("--video", "--out", folder / "out", "--json"),
    )
    assert said.status == 0, said.err
    line, zone = said.object["counts"]
    assert (line["place"], line["class"], line["in"], line["out"]) == ("middle", "all", 1, 1)
    assert (zone["in"], zone["out"], zone["inside"], zone["most"]) == (2, 1, 1, 1)
    assert "middle" in said.err
    return folder


def test_a_run_has_events_a_picture_a_video_and_a_section(run: Path) -> None:
    rows = [line.split(",") for line in (run / "out" / "counts.csv").read_text().splitlines()]
    assert rows[0][:6] == ["time", "frame", "kind", "place", "direction", "identity"]
    assert sorted((row[2], row[4]) for row in rows[1:] if row[3] == "middle") == [
        ("cross", "in"),
        ("cross", "out"),
    ]
    picture = cv2.imread(str(run / "out" / "counts.png"))
    assert picture is not None
    assert picture.shape == (240, 320, 3)
    # The line and the zone are seen.
    assert abs(picture[30:60, 160].astype(int) - 90).max() > 60
    assert picture[120, 50, 0] > picture[120, 300, 0] + 15
    video = cv2.VideoCapture(str(run / "out" / "counts.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 40
    page = (run / "out" / "report.html").read_text()
    assert "Lines and zones" in page
    assert ">middle<" in page


def test_ways_between_zones_are_a_file_and_in_the_page(run: Path, tmp_path: Path) -> None:
    zones = ("--zone", "west=0,0,150,0,150,240,0,240", "--zone", "east=170,0,320,0,320,240,170,240")
    said = phdtrack("count", run / "out", *zones, "--out", tmp_path / "two", "--json")
    assert said.status == 0, said.err
    ways = {(one["start"], one["end"]): one["objects"] for one in said.object["flows"]}
    # Two people cross the frame, one each way.
    assert ways == {("west", "east"): 1, ("east", "west"): 1}
    with (tmp_path / "two" / "flows.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["from"], row["to"], row["objects"]) for row in rows] == [
        ("west", "east", "1"),
        ("east", "west", "1"),
    ]
    for name in ("counts_minutes.csv", "counts_hours.csv"):
        with (tmp_path / "two" / name).open() as file:
            sums = list(csv.DictReader(file))
        assert [(row["start"], row["place"], row["in"]) for row in sums] == [
            ("0.000", "west", "2"),
            ("0.000", "east", "2"),
        ]
    page = (tmp_path / "two" / "counts.html").read_text()
    assert "From zone to zone" in page
    assert page.count("Bar chart of passages in and out of") == 2
    # One zone has no ways.
    assert not (run / "out" / "flows.csv").exists()


def test_count_takes_the_frames_and_motion_of_track(run: Path, tmp_path: Path) -> None:
    asked = ("count", run / "w.mp4", "--detections", run / "det" / "det.txt", "--line", LINE)
    # Both have crossed after frame 28, and none before frame 20.
    for frames, crossed in (("1-15", 0), ("31-40", 0), ("10-40", 2)):
        out = tmp_path / frames
        said = phdtrack(*asked, "--frames", frames, "--out", out, "--json")
        (line,) = said.object["counts"]
        assert line["in"] + line["out"] == crossed
        begin, end = map(int, frames.split("-"))
        assert said.object["frames"] == end - begin + 1
    still = ("--camera-motion", "flow", "--checkpoint-every", 0, "--out", tmp_path / "still")
    assert "camera_motion" in phdtrack(*asked, *still, "--json").object
    for option in (("--frames", "1-15"), ("--camera-motion", "flow")):
        known = refused("count", run / "gt" / "gt.txt", "--line", LINE, *option)
        assert f"{option[0]}: the tracks come from" in known


def test_zones_that_share_a_corner_are_both_filled_and_named():
    dark = np.zeros((480, 640, 3), np.uint8)
    corners = [((200, 200), (200 + w, 200), (200 + w, 400), (200, 400)) for w in (100, 200)]
    zones = [Place(name, points, True) for name, points in zip("ab", corners, strict=True)]
    one, both = (drawn(dark, zones[:n], []) for n in (1, 2))
    assert both[300, 250].any()
    assert both[300, 350].any()
    # Above the zones stand the plates, one on top of the other.
    heights = [int(image[:195].any(axis=(1, 2)).sum()) for image in (one, both)]
    assert heights[1] >= 2 * heights[0] > 10


def test_other_lines_are_counted_among_the_tracks_that_are_there(run: Path, tmp_path: Path) -> None:
    before = (run / "out" / "run.json").read_bytes()
    assert "--overwrite" in refused("count", run / "out", "--line", LINE)
    said = phdtrack(
        "count", run / "out", "--line", "door=150,0,150,240", "--out", tmp_path / "more"
    )
    assert said.status == 0
    assert said.out.split("\n\n")[1].splitlines()[1].split()[:4] == ["door", "all", "1", "1"]
    assert ">door<" in (tmp_path / "more" / "counts.html").read_text()
    said = phdtrack("count", run / "out", "--line", LINE, "--overwrite", "--json")
    assert said.object["counts"][0]["in"] == 1
    assert not (run / "out" / "counts.mp4").exists()
    assert (run / "out" / "run.json").read_bytes() == before


def test_tracks_in_a_file_with_the_video_or_without(run: Path, tmp_path: Path) -> None:
    truth = run / "gt" / "gt.txt"
    said = phdtrack("count", truth, "--line", LINE, "--out", tmp_path / "a", "--json")
    assert (said.object["fps"], said.object["counts"][0]["out"]) == (25, 1)
    said = phdtrack(
        "count",
        run / "w.mp4",
        "--tracks",
        truth,
        "--line",
        LINE,
        "--out",
        tmp_path / "b",
        "--blur",
        "boxes",
    )
    assert said.status == 0
    assert (tmp_path / "b" / "counts.png").exists()
    (tmp_path / "t.txt").write_bytes(truth.read_bytes())
    assert "the rate of the frames is not known" in refused(
        "count", tmp_path / "t.txt", "--line", LINE
    )


def test_places_in_a_file_and_what_looks_like_a_mistake(run: Path, tmp_path: Path) -> None:
    places = tmp_path / "places.toml"
    places.write_text(
        '[[line]]\nname = "far"\npoints = [[900, 900], [950, 900]]\nclasses = ["car"]\n'
    )
    said = phdtrack(
        "count", run / "out", "--places", places, "--zone", ZONE, "--out", tmp_path / "c", "--video"
    )
    assert "line 'far' counts nothing: it lies outside of the picture of 320x240" in said.err
    assert "it asks for car, and the tracks have no such class. There are 0." in said.err
    assert (tmp_path / "c" / "counts.mp4").exists()
    assert said.out.count("counts.mp4") == 1


def test_existing_counts_are_not_deleted(run: Path, tmp_path: Path) -> None:
    counted = tmp_path / "counted"
    assert phdtrack("count", run / "gt" / "gt.txt", "--line", LINE, "--out", counted).status == 0
    before = {file: file.read_bytes() for file in counted.iterdir()}
    assert "tracks.csv" in refused("count", counted, "--line", LINE, "--overwrite")
    assert {file: file.read_bytes() for file in counted.iterdir()} == before


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((), "no line or zone given. Say --line"),
        (("--line", LINE, "--tracks", "tracks.csv"), "has tracks of its own"),
        (("--line", "160,0,160,240"), "expected NAME=x1,y1,x2,y2 in pixels, got '160,0,160,240'"),
        (("--line", "a=160,0,160"), "expected NAME=x1,y1,x2,y2"),
        (("--line", "a=160,0"), "line 'a': expected at least 2 points, got 1"),
        (("--line", "a=160,0"), "Name the pixels of each, as a=x1,y1,x2,y2."),
        (("--zone", "a=0,0,9,0"), "zone 'a': expected at least 3 points, got 2"),
        (("--line", LINE, "--zone", "middle=0,0,9,0,9,9"), "two places are called 'middle'"),
        (("--line", LINE, "--filter", "mht"), "--filter: the tracks come from"),
    ],
)
def test_what_is_refused(run: Path, given: tuple[str, ...], words: str) -> None:
    assert words in refused("count", run / "out", *given)


def test_a_camera_is_for_live() -> None:
    assert "Use phdtrack live" in refused("count", "rtsp://127.0.0.1:9/x", "--line", LINE)


@pytest.mark.parametrize("kind", sorted(EXPORTS))
def test_a_run_is_exported_in_every_format(run: Path, tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"t{EXPORTS[kind]}"
    said = phdtrack("export", run / "out", "--to", kind, "--out", path, "--json")
    rows = read_tracks(run / "out" / "tracks.csv")
    assert (said.object["rows"], said.object["identities"]) == (len(rows), 2)
    again = read_tracks(path, kitti="object" if kind == "kitti" else "")
    assert again.identity.tolist() == rows.identity.tolist()
    assert "expected the name of a file, got -" in refused(
        "export", run / "out", "--to", kind, "--out", "-"
    )
    assert "exists already" in refused("export", run / "out", "--to", kind, "--out", path)
    assert (
        phdtrack(
            "export", run / "out" / "tracks.csv", "--to", kind, "--out", path, "--overwrite"
        ).status
        == 0
    )


def test_a_run_of_a_part_is_counted_exported_and_scored_as_one(run: Path, tmp_path: Path) -> None:
    part = tmp_path / "part"
    truth = run / "gt" / "gt.txt"
    given = (
        "track",
        run / "w.mp4",
        "--detections",
        run / "det" / "det.txt",
        "--frames",
        "21-40",
        "--out",
    )
    assert phdtrack(*given, part).status == 0
    everywhere = "all=-9,-9,999,-9,999,999,-9,999"
    said = phdtrack("count", part, "--zone", everywhere, "--out", tmp_path / "counts", "--json")
    rows = read_tracks(part / "tracks.csv")
    assert said.object["frames"] == 20
    assert said.object["counts"][0]["mean"] == pytest.approx(len(rows) / 20, rel=0.06)
    for kind in ("coco", "cvat"):
        path = tmp_path / f"part{EXPORTS[kind]}"
        assert phdtrack("export", part, "--to", kind, "--out", path).status == 0
        assert read_tracks(path).frame.tolist() == rows.frame.tolist()
    said = phdtrack("evaluate", "--truth", truth, "--tracks", part / "tracks.csv")
    assert "the run tracked the frames 21-40 alone" in said.err
    assert "there is no frame 50: the last one is 40" in refused(
        *given[:-3], "--frames", "50-", "--out", tmp_path / "none"
    )
    assert "differs in input.frames" in refused(*given[:-3], "--out", part, "--resume")
    assert "Give one of them" in refused(*given, part, "--resume", "--overwrite")


def test_an_export_lies_beside_the_tracks(run: Path) -> None:
    assert phdtrack("export", run / "out", "--to", "coco").status == 0
    assert (run / "out" / "tracks_coco.json").exists()
