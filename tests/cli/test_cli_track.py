"""`phdtrack track` and `detect`: what they read, what they write, and every way to ask for the
impossible.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, refused, walkers

from phdtrack.formats import read_detections, read_tracks
from phdtrack.run import directory as rundir
from phdtrack.video import VideoWriter, open_source

FILES = {
    rundir.TRACKS,
    rundir.ONLINE,
    rundir.STATES,
    rundir.DETECTIONS,
    rundir.OBJECTS,
    rundir.MINUTES,
    rundir.HOURS,
    rundir.HEATMAP,
    rundir.REPORT,
    rundir.RUN,
}


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return walkers(tmp_path_factory.mktemp("walkers") / "walkers")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video of 40 frames in which two dark boxes cross a noisy grey."""
    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    rng = np.random.default_rng(5)
    ground = rng.integers(120, 136, (240, 320, 3))
    with VideoWriter(path, 320, 240, 25.0) as writer:
        for k in range(1, 41):
            image = (ground + rng.integers(-2, 3, ground.shape)).astype(np.uint8)
            for x, y in ((20 + 5 * k, 60), (270 - 5 * k, 150)):
                image[y : y + 60, x : x + 24] = 30
            writer.write(image)
    return path


@pytest.mark.parametrize("kind", ["pmb", "gm-phd", "gm-cphd"])
def test_detections_alone(kind: str, sequence: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    truth = sequence / "gt" / "gt.txt"
    given = ("--detections", sequence / "det" / "det.txt", "--truth", truth, "--filter", kind)
    said = phdtrack("track", *given, "--out", out, "--json")
    assert said.status == 0, said.err
    assert {path.name for path in out.iterdir()} == FILES
    document = said.object
    assert document == json.loads((out / rundir.RUN).read_text())
    assert document["configuration"]["filter"]["kind"] == kind
    assert [document[key] for key in ("frames", "tracks", "complete", "seed")] == [40, 2, True, 0]
    assert document["scores"]["MOTA"] > 0.9
    assert document["input"] == {"source": "", "detections": str(sequence / "det" / "det.txt")}
    assert sorted(set(read_tracks(out / rundir.TRACKS).identity)) == [1, 2]


def test_the_page_names_the_tables_without_header(sequence: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    said = phdtrack("track", "--detections", sequence / "det" / "det.txt", "--out", out)
    assert said.status == 0, said.err
    bare = {file.name for file in out.glob("*.csv") if file.read_text()[:1].isdigit()}
    page = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "track-a-video.md"
    named = re.search(r"\n(`[^\n]*) have no header line", page.read_text(encoding="utf-8"))
    assert named is not None
    assert set(re.findall(r"`([\w.]+)`", named[1])) == bare
    rows = (out / rundir.DETECTIONS).read_text().splitlines()
    assert {len(row.split(",")) for row in rows} == {11}


def test_threads_reach_the_filter_and_change_nothing(sequence: Path, tmp_path: Path) -> None:
    texts = []
    for threads in (1, 3):
        out = tmp_path / str(threads)
        given = ("--filter", "particle-phd", "--threads", threads)
        said = phdtrack(
            "track", "--detections", sequence / "det" / "det.txt", *given, "--out", out, "--json"
        )
        assert said.object["configuration"]["filter"]["threads"] == threads
        texts.append(
            [(out / file).read_bytes() for file in (rundir.TRACKS, rundir.STATES, rundir.ONLINE)]
        )
    assert texts[0] == texts[1]


def test_a_video(clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    said = phdtrack("track", clip, "--out", out, "--json")
    assert said.status == 0, said.err
    assert {path.name for path in out.iterdir()} == FILES | {rundir.VIDEO, rundir.DETECTED}
    assert said.object["frames"] == 40
    assert len(list(open_source(out / rundir.VIDEO))) == 40
    assert len(read_tracks(out / rundir.TRACKS)) > 30


def test_detect_writes_coordinates_of_the_video(clip: Path, tmp_path: Path) -> None:
    tables = []
    for width in (0, 160):
        file = tmp_path / str(width) / rundir.DETECTIONS
        said = phdtrack("detect", clip, "--max-width", width, "--out", file.parent, "--json")
        assert said.status == 0, said.err
        assert said.object["file"] == str(file)
        tables.append(read_detections(file))
        assert len(tables[-1]) == said.object["detections"] > 30
    full, half = (
        boxes[np.argsort(boxes[:, 0])] for boxes in (table.at(35).xyxy for table in tables)
    )
    assert len(full) == len(half) == 2
    assert full == pytest.approx(half, abs=8)
    given = ["--frame-size", "320x240", "--fps", 12.5, "--filter", "none", "--json"]
    said = phdtrack("track", "--detections", file, *given, "--out", tmp_path / "run")
    assert said.object["source"] == {"name": "detections", "width": 320, "height": 240, "fps": 12.5}


def test_boxes_outside_the_frame_are_left_out_and_told(tmp_path: Path) -> None:
    folder = walkers(tmp_path / "s")
    file = folder / "det" / "det.txt"
    file.write_text(file.read_text() + "7,-1,5000,10,20,40,1,-1,-1,-1\n")
    said = phdtrack(
        "track", "--detections", file, "--out", tmp_path / "run", "--json", "--filter", "none"
    )
    assert said.status == 0
    assert "1 of 81 boxes" in said.err
    assert "frame 7" in said.err
    assert said.object["detections"] == 80


def test_detections_beyond_the_most_are_left_out_and_counted(
    sequence: Path, tmp_path: Path
) -> None:
    file = sequence / "det" / "det.txt"
    run = tmp_path / "run"
    said = phdtrack(
        "track", "--detections", file, "--out", run, "--filter", "none", "--max-detections", 1
    )
    assert said.status == 0
    left_out = json.loads((run / "run.json").read_text())["boxes_left_out"]
    frames = [line.split(",")[0] for line in file.read_text().splitlines()]
    assert {reason: count for reason, count in left_out.items() if count} == {
        "surplus": len(frames) - len(set(frames))
    }
    assert (
        f"{left_out['surplus']} boxes left out: more in a frame than limits.max_detections"
        in said.err
    )


def test_an_empty_file_of_detections_is_an_empty_run(tmp_path: Path) -> None:
    folder = walkers(tmp_path / "s")
    (folder / "det" / "det.txt").write_text("")
    said = phdtrack(
        "track", "--detections", folder / "det" / "det.txt", "--out", tmp_path / "run", "--json"
    )
    assert said.status == 0, said.err
    assert (said.object["frames"], said.object["tracks"]) == (40, 0)


@pytest.mark.parametrize(
    ("kind", "setting"),
    [("pmb", "filter.history=7"), ("particle-phd", "filter.particles_per_target=300")],
)
def test_the_configuration_of_a_run_can_be_run_again(
    kind: str, setting: str, sequence: Path, tmp_path: Path
) -> None:
    given = ["--detections", sequence / "det" / "det.txt", "--seed", 3]
    chosen = ("--filter", kind, "--set", "sensor.detection_probability=0.75", "--set", setting)
    first = phdtrack("track", *given, *chosen, "--out", tmp_path / "a", "--json")
    config = tmp_path / "again.toml"
    used = first.object["configuration"]
    lines = ["preset = " + json.dumps(used["preset"])]
    for name in used.keys() - {"preset"}:
        lines += [
            f"[{name}]",
            *(f"{key} = {json.dumps(value)}" for key, value in used[name].items()),
        ]
    config.write_text("\n".join(lines))
    second = phdtrack("track", *given, "--config", config, "--out", tmp_path / "b", "--json")
    assert second.status == 0, second.err
    assert second.object["configuration"] == used
    assert (tmp_path / "a" / rundir.TRACKS).read_bytes() == (
        tmp_path / "b" / rundir.TRACKS
    ).read_bytes()


# What cannot be: one sentence, status 2, nothing written.


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["SOURCE", "--detections"]),
        (["nowhere.mp4"], ["nowhere.mp4"]),
        (["{det}"], ["det.txt", "--detections"]),
        (["{clip}", "--detector", "chagne"], ["--detector", "chagne", "change"]),
        (["{clip}", "--detector", "file"], ["--detections"]),
        (["{clip}", "--detector", "mog2", "--detections", "{det}"], ["--detector", "det.txt"]),
        (["{clip}", "--mask", "{det}", "--detections", "{det}"], ["--mask"]),
        (["{clip}", "--mask", "nowhere.png"], ["nowhere.png"]),
        (["{clip}", "--frame-size", "100x100"], ["--frame-size", "320x240"]),
        (["{clip}", "--set", "detector.min_aera=0.1"], ["min_aera", "min_area"]),
        (["{clip}", "--set", "detector.min_area=big"], ["detector.min_area", "a number", "'big'"]),
        (["{clip}", "--set", "detector.window=2.5"], ["detector.window", "whole number"]),
        (["{clip}", "--set", "detector.window=0"], ["detector.window"]),
        (
            ["{clip}", "--detector", "mog2", "--set", "detector.min_area=-1"],
            ["detector.min_area", "-1"],
        ),
        (["{clip}", "--config", "nowhere.toml"], ["nowhere.toml"]),
        (["{clip}", "--truth", "nowhere.txt"], ["nowhere.txt"]),
        (["--detections", "nowhere.txt"], ["nowhere.txt"]),
        (["--detections", "{det}", "--frame-size", "big"], ["--frame-size", "big", "1920x1080"]),
        (["--detections", "{det}", "--frame-size", "0x10"], ["--frame-size"]),
        (["--detections", "{det}", "--max-width", "100"], ["--max-width"]),
        (["--detections", "{det}", "--fps", "inf"], ["--fps"]),
        (["--detections", "{plain}"], ["--frame-size", "seqinfo.ini"]),
        (["--detections", "{plain}", "--frame-size", "320x240"], ["--fps", "seqinfo.ini"]),
        (["--detections", "{det}", "--frame-size", "4x4"], ["4x4", "outside"]),
    ],
)
def test_impossible_requests(
    arguments: list[str], words: list[str], clip: Path, sequence: Path, tmp_path: Path
) -> None:
    plain = walkers(tmp_path / "plain", seqinfo=False)
    places = {"clip": clip, "det": sequence / "det" / "det.txt", "plain": plain / "det" / "det.txt"}
    sentence = refused(
        "track", *(text.format(**places) for text in arguments), "--out", tmp_path / "run"
    )
    assert all(word in sentence for word in words), sentence
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("command", ["track", "detect"])
def test_a_picture_too_small_to_search_leaves_nothing_behind(
    command: str, clip: Path, tmp_path: Path
) -> None:
    sentence = refused(command, clip, "--max-width", 2, "--out", tmp_path / "run")
    assert "320x240" in sentence
    assert not list(tmp_path.glob("run/*"))


def test_an_earlier_run_is_kept(sequence: Path, tmp_path: Path) -> None:
    arguments = [
        "track",
        "--detections",
        sequence / "det" / "det.txt",
        "--filter",
        "none",
        "--out",
        tmp_path,
    ]
    (tmp_path / rundir.TRACKS).write_text("precious")
    assert "--overwrite" in refused(*arguments)
    (tmp_path / "folder" / rundir.REPORT).mkdir(parents=True)
    assert "report.html is a directory" in refused(
        *arguments[:-1], tmp_path / "folder", "--overwrite"
    )
    assert (tmp_path / rundir.TRACKS).read_text() == "precious"
    (tmp_path / "notes.txt").write_text("mine")
    assert phdtrack(*arguments, "--overwrite").status == 0
    assert (tmp_path / rundir.TRACKS).read_text() != "precious"
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)])
def test_what_a_run_reads_is_never_replaced(
    clip: Path, sequence: Path, tmp_path: Path, overwrite: tuple[str, ...]
) -> None:
    found = sequence / "det" / "det.txt"
    truth = sequence / "gt" / "gt.txt"
    video, boxes, tracks = (
        tmp_path / name for name in (rundir.VIDEO, rundir.DETECTIONS, rundir.TRACKS)
    )
    before = {video: clip.read_bytes(), boxes: found.read_bytes(), tracks: truth.read_bytes()}
    for copy, content in before.items():
        copy.write_bytes(content)
    sized = ("--frame-size", "320x240", "--fps", 25)
    for given in (
        [video],
        ["--detections", boxes, *sized],
        ["--detections", found, "--truth", tracks],
    ):
        words = refused("track", *given, "--out", tmp_path, *overwrite)
        assert (
            "is read for this run" in words if overwrite else "holds files of these names" in words
        )
    assert {copy: copy.read_bytes() for copy in tmp_path.iterdir()} == before


def test_the_directory_of_a_run_is_no_folder_of_pictures(tmp_path: Path) -> None:
    (tmp_path / "counts.csv").write_text("")
    (tmp_path / "counts.png").write_text("")
    assert "the directory of a run" in refused("track", tmp_path, "--out", tmp_path / "run")


def test_detections_of_later_frames_are_told(clip: Path, sequence: Path, tmp_path: Path) -> None:
    rows = [line.split(",", 1) for line in (sequence / "det" / "det.txt").read_text().splitlines()]
    late = tmp_path / "late.txt"
    late.write_text("".join(f"{int(number) + 30},{rest}\n" for number, rest in rows))
    said = phdtrack(
        "track", clip, "--detections", late, "--out", tmp_path / "run", "--no-video", "--json"
    )
    (warning,) = said.object["warnings"]
    assert "the detections continue to frame 70, the frames end at 40" in warning
    part = phdtrack(
        "track",
        clip,
        "--detections",
        late,
        "--out",
        tmp_path / "part",
        "--frames",
        "32-35",
        "--json",
    )
    assert part.object["warnings"] == []
