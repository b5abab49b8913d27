"""Every command takes the times of a video from its stamps, and writes videos at these times."""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from cli_runner import phdtrack
from pyarrow import parquet

from phdtrack.formats import read_tracks
from phdtrack.types import Image
from phdtrack.video import open_source

WIDE = 320
HIGH = 240
SPEED = 20.0
# The feet of a walker are at x = 40 + 20 t: it is in the zone from 5 s to 10 s.
ZONE = "box=138.5,60,238.5,60,238.5,230,138.5,230"
VARIABLE = np.r_[np.arange(60) / 30, 2 + np.arange(60) / 5]
PAUSE = np.r_[np.arange(40) / 20, np.arange(40) / 20 + 22]
EVEN = np.arange(140) / 10


def box(time: float) -> tuple[float, float, float, float]:
    return 20 + SPEED * time, 100.0, 60 + SPEED * time, 200.0


def picture_at(time: float) -> Image:
    """A finely chequered walker on grey, which blurring changes."""
    image = np.full((HIGH, WIDE, 3), 120, np.uint8)
    left, top, right, bottom = (round(side) for side in box(time))
    tile = np.kron([[0, 255], [255, 0]], np.ones((2, 2))).astype(np.uint8)
    inside = np.tile(tile, (25, 10))[..., None]
    image[top:bottom, left:right] = inside[:, : min(right, WIDE) - left]
    return image


def scene(
    folder: Path, name: str, times: np.ndarray, begin: float = 0.0, aspect: Fraction | None = None
) -> Path:
    """A video of the walker at these times, with stamps from ``begin`` s on, and its detections."""
    folder.mkdir(exist_ok=True)
    with av.open(str(folder / name), "w") as container:
        video = container.add_stream("libx264", options={"crf": "18", "g": "10", "bf": "0"})
        video.width = WIDE
        video.height = HIGH
        video.pix_fmt = "yuv420p"
        video.codec_context.time_base = Fraction(1, 90_000)
        if aspect is not None:
            video.codec_context.sample_aspect_ratio = aspect
        for time in times:
            frame = av.VideoFrame.from_ndarray(picture_at(time), format="bgr24")
            frame.pts = round(90_000 * (begin + time))
            frame.time_base = Fraction(1, 90_000)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
    rows = []
    for number, time in enumerate(times, start=1):
        left, top, right, bottom = box(time)
        rows.append(f"{number},-1,{left},{top},{right - left},{bottom - top},0.9\n")
    (folder / "det.txt").write_text("".join(rows))
    return folder / name


def counted(*words: object) -> list[tuple[str, float]]:
    """Kinds and seconds of the events that a command of `count` finds."""
    out = words[words.index("--out") + 1]
    said = phdtrack("count", *words)
    assert said.status == 0, said.err
    rows = [line.split(",") for line in (Path(str(out)) / "counts.csv").read_text().splitlines()]
    return [(row[2], float(row[0])) for row in rows[1:]]


def written(path: Path) -> list[float]:
    return [frame.time for frame in open_source(path)]


VIDEOS = {
    "variable.mp4": (VARIABLE, 0.0),
    "variable.mkv": (VARIABLE, 0.0),
    "even.ts": (EVEN, 1.4),
    "hour.ts": (EVEN, 3600.0),
}
# The second of each kind of container, and of each kind of times.
OTHERS = ("variable.mkv", "even.ts")


@pytest.mark.parametrize("name", VIDEOS)
def test_count_reports_true_times(tmp_path: Path, name: str) -> None:
    """While it tracks, among the tracks of the run, and among tracks in a file."""
    times, begin = VIDEOS[name]
    video = scene(tmp_path / "in", name, times, begin)
    given = ("--detections", video.with_name("det.txt"), "--zone", ZONE)
    run = tmp_path / "run"
    first = counted(video, *given, "--video", "--out", run)
    assert [kind for kind, _ in first] == ["enter", "exit"]
    # It leaves the zone when it is ten pixels behind the border.
    np.testing.assert_allclose([time for _, time in first], [5.0, 10.5], atol=0.21)
    again = counted(run, "--zone", ZONE, "--out", tmp_path / "again")
    tracks = ("--tracks", run / "tracks.csv")
    known = counted(video, *tracks, "--zone", ZONE, "--out", tmp_path / "known")
    for other in (again, known):
        np.testing.assert_allclose([time for _, time in other], [time for _, time in first])
    np.testing.assert_allclose(written(run / "counts.mp4"), times, atol=2e-3)


def test_rate_on_the_command_line_replaces_times(tmp_path: Path) -> None:
    video = scene(tmp_path / "in", "v.mp4", VARIABLE)
    given = ("--detections", video.with_name("det.txt"), "--zone", ZONE, "--fps", 10)
    first = counted(video, *given, "--out", tmp_path / "run")
    # Frames 76 and 104 by their numbers.
    np.testing.assert_allclose([time for _, time in first], [7.5, 10.3], atol=0.2)


def test_a_pause_ends_a_visit_when_last_seen(tmp_path: Path) -> None:
    """20 s without pictures: somebody who was there before has left, at the last picture."""
    video = scene(tmp_path / "in", "v.mp4", PAUSE)
    kept = [
        line
        for line in video.with_name("det.txt").read_text().splitlines()
        if int(line.split(",")[0]) <= 40
    ]
    video.with_name("det.txt").write_text("\n".join(kept) + "\n")
    zone = "all=0,0,320,0,320,240,0,240"
    given = ("--detections", video.with_name("det.txt"), "--zone", zone)
    found = counted(video, *given, "--out", tmp_path / "run")
    assert [kind for kind, _ in found] == ["enter", "exit"]
    assert found[1][1] < 2.5
    table = json.loads((tmp_path / "run" / "run.json").read_text())["counts"]
    assert table[0]["longest"] < 2.5


@pytest.mark.parametrize("name", ["variable.mp4", "hour.ts"])
def test_annotated_videos_have_the_times_of_the_source(tmp_path: Path, name: str) -> None:
    times, begin = VIDEOS[name]
    video = scene(tmp_path / "in", name, times, begin, Fraction(16, 11))
    given = ("--detections", video.with_name("det.txt"))
    assert phdtrack("track", video, *given, "--out", tmp_path / "run").status == 0
    source = open_source(video)
    assert source.info.pixel_aspect == pytest.approx(16 / 11)
    drawn = open_source(tmp_path / "run" / "annotated.mp4")
    assert drawn.info.pixel_aspect == pytest.approx(16 / 11)
    found = {frame.number: frame for frame in drawn}
    np.testing.assert_allclose([frame.time for frame in found.values()], times, atol=2e-3)
    # The picture at each time is that of the source.
    for number in (1, 50, len(times)):
        left = round(box(times[number - 1])[0])
        column = found[number].image[110:190, :, :].std(axis=(0, 2))
        inside = column[left + 4 : min(left + 36, WIDE)]
        assert len(inside) == 0 or inside.mean() > 5 * column[: left - 4].mean()
    # A part begins at its first frame.
    part = ("--frames", "41-60", "--out", tmp_path / "part")
    assert phdtrack("track", video, *given, *part).status == 0
    found_part = written(tmp_path / "part" / "annotated.mp4")
    np.testing.assert_allclose(found_part, times[40:60] - times[40], atol=2e-3)


@pytest.mark.parametrize(
    "name",
    ["variable.mp4", "hour.ts", *(pytest.param(one, marks=pytest.mark.slow) for one in OTHERS)],
)
def test_the_counted_picture_hides_boxes(tmp_path: Path, name: str) -> None:
    times, begin = VIDEOS[name]
    video = scene(tmp_path / "in", name, times, begin)
    given = ("--detections", video.with_name("det.txt"), "--zone", ZONE, "--blur", "boxes")
    counted(video, *given, "--video", "--out", tmp_path / "run")
    tracks = ("--tracks", tmp_path / "run" / "tracks.csv", "--blur", "boxes", "--zone", ZONE)
    counted(video, *tracks, "--out", tmp_path / "known")
    pictures = [cv2.imread(str(tmp_path / name / "counts.png")) for name in ("run", "known")]
    pictures += [frame.image for frame in open_source(tmp_path / "run" / "counts.mp4")]
    for image in pictures:
        assert image is not None
        # Neighbouring pixels of the chequers differ.
        rough = np.abs(np.diff(image[105:195].mean(axis=2), axis=1)).mean(axis=0)
        # Boxes and the zone have borders.
        assert (rough > 60).sum() < 12
    plain = np.abs(np.diff(picture_at(3.0)[105:195].mean(axis=2), axis=1)).mean(axis=0)
    assert (plain > 60).sum() > 15


def test_detections_without_a_track_are_hidden(tmp_path: Path) -> None:
    """Of a run, and of one that is counted again."""
    video = scene(tmp_path / "in", "v.mp4", EVEN)
    lines = video.with_name("det.txt").read_text().splitlines()
    video.with_name("det.txt").write_text("\n".join(lines[70:72]) + "\n")
    given = ("--detections", video.with_name("det.txt"))
    options = ("--zone", ZONE, "--blur", "boxes", "--video")
    counted(video, *given, *options, "--out", tmp_path / "run")
    assert (tmp_path / "run" / "tracks.csv").read_text() == ""
    counted(tmp_path / "run", *options, "--out", tmp_path / "again")
    left = round(box(EVEN[70])[0])
    for folder in ("run", "again"):
        shown = {one.number: one for one in open_source(tmp_path / folder / "counts.mp4")}
        for number, hidden in ((71, True), (80, False)):
            inside = shown[number].image[140:190, left + 20 : left + 38].mean(axis=2)
            assert (np.abs(np.diff(inside, axis=1)).mean() < 20) == hidden


def test_images_have_the_rate_that_is_stated_beside_them(tmp_path: Path) -> None:
    """At 10 a second in seqinfo.ini, and with a gap in the numbers of the files."""
    images = tmp_path / "walk" / "img1"
    images.mkdir(parents=True)
    rows = []
    for number, time in enumerate(EVEN, start=1):
        if 20 <= number < 25:
            continue
        cv2.imwrite(str(images / f"{number:06d}.png"), picture_at(time))
        left, top, right, bottom = box(time)
        rows.append(f"{number},-1,{left},{top},{right - left},{bottom - top},0.9\n")
    (tmp_path / "det.txt").write_text("".join(rows))
    (tmp_path / "walk" / "seqinfo.ini").write_text(
        f"[Sequence]\nname=walk\nframeRate=10\nimWidth={WIDE}\nimHeight={HIGH}\nseqLength=140\n"
    )
    given = ("--detections", tmp_path / "det.txt", "--zone", ZONE)
    found = counted(images, *given, "--video", "--out", tmp_path / "run")
    np.testing.assert_allclose([time for _, time in found], [5.0, 10.5], atol=0.11)
    again = counted(tmp_path / "run", "--zone", ZONE, "--video", "--out", tmp_path / "again")
    assert again == found
    wanted = np.delete(EVEN, np.arange(19, 24))
    for folder in ("run", "again"):
        np.testing.assert_allclose(written(tmp_path / folder / "counts.mp4"), wanted, atol=2e-3)
    # Without pictures the rate is that of the option.
    alone = (tmp_path / "det.txt", "--zone", ZONE, "--fps", 10, "--frame-size", "320x240")
    tracked = ("track", "--detections", *alone[:1], *alone[3:], "--out", tmp_path / "alone")
    assert phdtrack(*tracked).status == 0
    found = counted(tmp_path / "alone", "--zone", ZONE, "--out", tmp_path / "last")
    np.testing.assert_allclose([time for _, time in found], [5.0, 10.5], atol=0.11)


def test_stamps_far_ahead_do_not_split_a_walker(tmp_path: Path) -> None:
    """They are told in one line."""
    times = EVEN.copy()
    path = tmp_path / "in" / "v.mkv"
    scene(tmp_path / "in", "v.mkv", times)
    moved = tmp_path / "in" / "wrong.mkv"
    with av.open(str(path)) as source, av.open(str(moved), "w") as target:
        stream = source.streams.video[0]
        copy = target.add_stream_from_template(stream)
        for number, packet in enumerate(source.demux(stream)):
            if packet.pts is None:
                continue
            if number in (30, 70):
                packet.pts += 3_000_000
            packet.stream = copy
            target.mux(packet)
    given = ("--detections", tmp_path / "in" / "det.txt", "--zone", ZONE)
    said = phdtrack("count", moved, *given, "--out", tmp_path / "run")
    assert said.status == 0
    assert said.err.count("that cannot be right") == 1
    tracks = (tmp_path / "run" / "tracks.csv").read_text().splitlines()
    assert {line.split(",")[1] for line in tracks} == {"1"}
    rows = (tmp_path / "run" / "counts.csv").read_text().splitlines()[1:]
    np.testing.assert_allclose([float(row.split(",")[0]) for row in rows], [5.0, 10.5], atol=0.21)


@pytest.mark.usefixtures("batch_here")
def test_rows_before_the_first_states_have_true_times(tmp_path: Path) -> None:
    """Nobody is there while the rate changes; the corrected track begins before its first state."""
    video = scene(tmp_path / "in", "v.mp4", VARIABLE)
    lines = video.with_name("det.txt").read_text().splitlines()
    video.with_name("det.txt").write_text("\n".join(lines[79:]) + "\n")
    zone = ("--zone", "all=0,0,320,0,320,240,0,240")
    given = ("--detections", video.with_name("det.txt"))
    found = counted(video, *given, *zone, "--out", tmp_path / "run")
    assert found[0] == ("enter", pytest.approx(VARIABLE[79], abs=1e-3))
    assert counted(tmp_path / "run", *zone, "--out", tmp_path / "again") == found
    said = phdtrack("batch", video, "--out", tmp_path / "all", "--jobs", 1, "--", *given)
    assert said.status == 0, said.err
    rows = parquet.read_table(tmp_path / "all" / "tracks" / "v.parquet").to_pydict()
    np.testing.assert_allclose(rows["time"], VARIABLE[np.array(rows["frame"], int) - 1], atol=1e-3)


def test_compare_tracks_at_the_same_times(tmp_path: Path) -> None:
    video = scene(tmp_path / "in", "v.mp4", VARIABLE)
    given = ("--detections", video.with_name("det.txt"))
    assert phdtrack("track", video, *given, "--no-video", "--out", tmp_path / "run").status == 0
    compared = ("--filters", "pmb", "--seeds", 1, "--jobs", 1, "--out", tmp_path / "all")
    assert phdtrack("compare", video, *given, *compared).status == 0
    alone = read_tracks(tmp_path / "run" / "tracks.csv")
    (file,) = (tmp_path / "all").rglob("tracks.csv")
    together = read_tracks(file)
    np.testing.assert_array_equal(together.frame, alone.frame)
    np.testing.assert_allclose(together.xyxy, alone.xyxy, atol=1e-2)


@pytest.mark.parametrize("name", ["variable.mp4", pytest.param("even.ts", marks=pytest.mark.slow)])
@pytest.mark.usefixtures("batch_here")
def test_segments_are_cut_by_time(tmp_path: Path, name: str) -> None:
    times, begin = VIDEOS[name]
    video = scene(tmp_path / "in", name, times, begin)
    options = ("--detections", video.with_name("det.txt"))
    said = phdtrack(
        *("batch", video, "--out", tmp_path / "all", "--jobs", 1),
        *("--segment", 5, "--overlap", 2, "--", *options),
    )
    assert said.status == 0, said.err
    run = tmp_path / "all" / "runs" / video.stem
    parts = json.loads((run / "run.json").read_text())["segments"]
    bounds = [times[part["begin"] - 1] for part in parts]
    np.testing.assert_allclose(np.diff(bounds), times[-1] / len(parts), atol=0.3)
    for part, following in pairwise(parts):
        common = times[part["last"] - 1] - times[following["first"] - 1]
        assert common == pytest.approx(2.0, abs=0.5)
    found = counted(run, "--zone", ZONE, "--out", tmp_path / "counts")
    np.testing.assert_allclose([time for _, time in found], [5.0, 10.5], atol=0.21)


def test_a_run_without_its_video_keeps_its_times(tmp_path: Path) -> None:
    video = scene(tmp_path / "made", "clip.mp4", VARIABLE)
    run = tmp_path / "run"
    words = ("--detections", video.with_name("det.txt"), "--out", run, "--no-video")
    assert phdtrack("track", video, *words).status == 0
    asked = ("--zone", ZONE, "--out", tmp_path / "counts", "--overwrite")
    here = counted(run, *asked)
    video.unlink()
    for tracks in (run, run / "tracks.csv"):
        assert counted(tracks, *asked) == here
        assert "unknown" not in phdtrack("count", tracks, *asked).err
    (run / "states.csv").unlink()
    for tracks in (run, run / "tracks.csv"):
        said = phdtrack("count", tracks, *asked)
        assert "states.csv and the video" in said.err
        assert "frames/s assumed" in said.err
    # What the user states is no assumption.
    assert "assumed" not in phdtrack("count", run, *asked, "--fps", 10).err
