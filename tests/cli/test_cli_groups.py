"""`phdtrack groups`: from a video and from detections; every file, and every way to ask wrongly."""

from __future__ import annotations

import csv
import json
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, refused

from phdtrack.formats import read_tracks
from phdtrack.run import TrackedFrame
from phdtrack.run import directory as rundir
from phdtrack.scene import LearnedDensity, Scene, SceneDensity, write_scene
from phdtrack.video import VideoWriter, open_source

# Tests look at pages.
pytestmark = pytest.mark.usefixtures("paged")

# Ten pixels are a metre, x to the right and y up, the origin in the lower left corner.
CAMERA = (
    "homography = [[0.1, 0.0, 0.0], [0.0, -0.1, 24.0], [0.0, 0.0, 1.0]]\nmaps ="
    ' "pixel-to-ground"\nunit = "m"\n'
)
FRAMES = 40
RATE = 10.0
FILES = {name for name in rundir.RUN_FILES if not name.startswith("counts")} - {
    rundir.FLOWS,
    rundir.CAMERA_MOTION,
    rundir.EMBEDDINGS,
}


def walking(k: int) -> np.ndarray:
    """(3, 2) feet in metres at frame k: two side by side to the right, one who comes towards
    them.
    """
    t = k / RATE
    return np.array([[4 + 1.2 * t, 10], [4 + 1.2 * t, 11], [24 - 1.2 * t, 10.5]])


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """camera.toml, det.txt, edges.txt, and a video of grey with dark people."""
    folder = tmp_path_factory.mktemp("street")
    rng = np.random.default_rng(1)
    (folder / "camera.toml").write_text(CAMERA)
    (folder / "edges.txt").write_text("# road\n0 8\n30,8\n\n0 13\n30 13\n")
    lines = []
    with VideoWriter(folder / "street.mp4", 320, 240, RATE) as video:
        for k in range(1, FRAMES + 1):
            image = np.full((240, 320, 3), 150, np.uint8)
            for x, y in walking(k):
                u = 10 * x
                v = 240 - 10 * y
                image[int(v) - 18 : int(v), int(u) - 3 : int(u) + 3] = 30
                du, dv = rng.normal(0, 0.5, 2)
                if not (k == 20 and y == 10):
                    lines.append(f"{k},-1,{u - 3 + du:.2f},{v - 18 + dv:.2f},6,18,1")
            video.write(image)
    (folder / "det.txt").write_text("\n".join(lines) + "\n")
    return folder


def table(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_video_with_detections(street: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    said = phdtrack(
        "groups", street / "street.mp4", "--detections", street / "det.txt",
        "--camera", street / "camera.toml",
        "--edges", street / "edges.txt", "--out", out, "--json",
    )  # fmt: skip
    assert said.status == 0, said.err
    assert {path.name for path in out.iterdir()} == FILES
    document = said.object
    assert document == json.loads((out / rundir.RUN).read_text())
    assert document["groups"]["identities"] >= 2
    assert document["groups"]["people_mean"] == pytest.approx(3, abs=0.3)
    assert document["configuration"]["filter"]["kind"] == "pmb"
    assert document["configuration"]["groups"]["kind"] == "pairs"
    counts = defaultdict(float)
    groups = table(out / rundir.GROUPS)
    for row in groups:
        counts[int(row["frame"])] += float(row["count"])
    # One who was missed once stays among the people.
    assert counts[20] > 2.05
    pair = [row for row in groups if row["frame"] == "15" and float(row["count"]) > 1.5]
    assert len(pair) == 1
    assert [float(pair[0][name]) for name in ("x", "y", "vx", "vy")] == pytest.approx(
        [5.8, 10.5, 1.2, 0], abs=0.25
    )
    assert pair[0]["contours"].startswith("MULTIPOLYGON (((")
    corner = pair[0]["contours_image"].removeprefix("MULTIPOLYGON (((").split(",")[0].split()
    assert abs(float(corner[0]) - 58) < 20
    assert abs(float(corner[1]) - 135) < 25
    members = [row for row in table(out / rundir.MEMBERS) if row["frame"] == "15"]
    sizes = Counter(row["group"] for row in members)
    assert (sizes[pair[0]["group"]], sorted(sizes.values())) == (2, [1, 2])
    assert {"appear"} <= {row["event"] for row in table(out / rundir.EVENTS)}
    first = table(out / rundir.WARNINGS)[0]
    assert float(first["seconds"]) <= 4
    assert float(first["y"]) == pytest.approx(10.5, abs=1)
    movie = open_source(out / rundir.PLAN)
    assert movie.info.width > 320
    assert sum(1 for _ in movie) == FRAMES
    page = (out / rundir.REPORT).read_text()
    assert "People and groups" in page
    assert "The ground plane" in page


def detected(street: Path) -> list[object]:
    """Options for the street's detections and camera, without its video."""
    return [
        *("--detections", street / "det.txt", "--frame-size", "320x240", "--fps", RATE),
        *("--camera", street / "camera.toml"),
    ]


def test_tracks_have_their_place(street: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    said = phdtrack("groups", *detected(street), "--out", out, "--no-video")
    assert said.status == 0, said.err
    assert {path.name for path in out.iterdir()} == FILES - {rundir.PLAN, rundir.VIDEO}
    rows = np.loadtxt(out / rundir.TRACKS, delimiter=",")
    foot = np.stack([rows[:, 2] + rows[:, 4] / 2, rows[:, 3] + rows[:, 5]])
    assert rows[:, 7] == pytest.approx(0.1 * foot[0], abs=1e-3)
    assert rows[:, 8] == pytest.approx(24 - 0.1 * foot[1], abs=1e-3)
    assert (rows[:, 9] == 0).all()
    assert len(read_tracks(out / rundir.TRACKS)) == len(rows)


def test_members_are_the_identities_of_the_corrected_tracks(street: Path, tmp_path: Path) -> None:
    """Whatever followed them: in the image or on the ground, by labels or by links; and of one who
    was missed, too.
    """
    for name in ("pmb", "gm-phd", "none"):
        for world in ("box", "plane"):
            out = tmp_path / f"{name}-{world}"
            kind = ("--filter", name, "--set", f"motion.kind={world}")
            said = phdtrack("groups", *detected(street), "--out", out, "--no-video", *kind)
            assert said.status == 0, said.err
            tracks = read_tracks(out / rundir.TRACKS)
            known = set(zip(tracks.frame.tolist(), tracks.identity.tolist(), strict=True))
            members = {
                (int(row["frame"]), int(row["member"])) for row in table(out / rundir.MEMBERS)
            }
            assert members <= known
            assert len(members) > 0.9 * len(known)
            groups = {(row["frame"], row["group"]) for row in table(out / rundir.MEMBERS)}
            assert 1.9 < len(groups) / len({frame for frame, _ in groups}) < 2.1


def test_detections_that_are_left_out_move_nobody(street: Path, tmp_path: Path) -> None:
    """Rows count all detections of a frame, also those of classes that are not tracked; places must
    be of the same.
    """
    rows = [line.split(",") for line in (street / "det.txt").read_text().splitlines()]
    lines = ["frame,left,top,width,height,confidence,class"]
    for k in range(1, FRAMES + 1):
        lines.append(f"{k},{250 - 2 * k},20,30,20,1,car")
        lines += [",".join([str(k), *row[2:7], "person"]) for row in rows if row[0] == str(k)]
    (tmp_path / "det.csv").write_text("\n".join(lines) + "\n")
    found = []
    for file, more in ((street / "det.txt", ()), (tmp_path / "det.csv", ("--classes", "person"))):
        options = ("--detections", file, *detected(street)[2:], "--no-video", *more)
        said = phdtrack("groups", *options, "--out", tmp_path / file.stem, "--overwrite")
        assert said.status == 0, said.err
        found.append(
            [row | {"contours_image": ""} for row in table(tmp_path / file.stem / rundir.GROUPS)]
        )
    assert found[0] == found[1]


def test_members_of_an_intensity_are_corrected_identities(street: Path, tmp_path: Path) -> None:
    """Those of an output delay, too, and of a filter of particles."""
    for name, more in (("gm-phd", ("--set", "associate.output_delay=4")), ("particle-phd", ())):
        out = tmp_path / name
        kind = ("--filter", name, "--set", "groups.kind=intensity", *more)
        assert phdtrack("groups", *detected(street), "--out", out, "--no-video", *kind).status == 0
        tracks = read_tracks(out / rundir.TRACKS)
        known = set(zip(tracks.frame.tolist(), tracks.identity.tolist(), strict=True))
        members = {(int(row["frame"]), int(row["member"])) for row in table(out / rundir.MEMBERS)}
        assert members <= known
        assert len(members) > 0.9 * len(known)
        told = {int(row["frame"]) for row in table(out / rundir.GROUPS)}
        assert told >= set(range(2, FRAMES + 1))


def test_a_learned_scene_is_used(street: Path, tmp_path: Path) -> None:
    """False alarms that were learned where people walk, ten thousand a frame: hardly anybody is
    found.
    """
    low = np.zeros(4)
    high = np.array([320.0, 240, 320, 240])
    mean = np.array([[140.0], [126], [6], [18]])
    density = SceneDensity(low, high, 1e-3, np.ones(1), mean, np.diag([60.0, 10, 2, 4])[None] ** 2)
    path = tmp_path / "there.json"
    write_scene(path, Scene(320, 240, 25.0, "street", clutter=LearnedDensity(1e4, density, 500)))
    given = (
        "groups",
        street / "street.mp4",
        "--detections",
        street / "det.txt",
        "--camera",
        street / "camera.toml",
    )
    for name, more in (("with", ("--scene", path)), ("without", ())):
        phdtrack(*given, "--no-video", *more, "--out", tmp_path / name)
    found = {name: read_tracks(tmp_path / name / rundir.TRACKS) for name in ("with", "without")}
    assert len(np.unique(found["without"].identity)) == 3
    assert len(found["with"]) < len(found["without"]) - 20


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ([], "--camera"),
        (
            ["--camera", "CAMERA", "--set", "groups.kind=intensity", "--filter", "none"],
            "no intensity",
        ),
        (
            ["--camera", "CAMERA", "--set", "groups.kind=intensity", "--set", "motion.kind=box"],
            "on the ground",
        ),
        (["--camera", "CAMERA", "--set", "motion.kind=point"], "motion.kind=box"),
        (["--camera", "CAMERA", "--set", "groups.distanc=1"], "distance"),
        (["--camera", "CAMERA", "--edges", "EDGES"], "expected a point of an edge"),
        (["--camera", "det.txt"], "det.txt"),
    ],
)
def test_what_cannot_be_done(street: Path, tmp_path: Path, more: list[str], says: str) -> None:
    (tmp_path / "edges.txt").write_text("1 2\n3 x\n")
    put = {
        "CAMERA": street / "camera.toml",
        "EDGES": tmp_path / "edges.txt",
        "det.txt": street / "det.txt",
    }
    given = [
        "--detections",
        street / "det.txt",
        "--frame-size",
        "320x240",
        "--fps",
        RATE,
        "--out",
        tmp_path / "run",
    ]
    assert says in refused("groups", *given, *(put.get(word, word) for word in more))
    assert not (tmp_path / "run").exists()


def test_ctrl_c_leaves_the_groups_up_to_there(
    street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from phdtrack.run.grouping import GroupObserver

    whole = GroupObserver.take

    def stopped(self: GroupObserver, tracked: TrackedFrame) -> None:
        if tracked.step.number == 15:
            raise KeyboardInterrupt
        whole(self, tracked)

    monkeypatch.setattr(GroupObserver, "take", stopped)
    # A busy machine draws little in half a second.
    monkeypatch.setattr("phdtrack.run.annotated_video.DRAWN_AFTER_SIGNAL", 600.0)
    said = phdtrack("groups", *detected(street), "--out", tmp_path / "run", "--json")
    assert said.status == 130
    assert said.object["complete"] is False
    assert max(int(row["frame"]) for row in table(tmp_path / "run" / rundir.GROUPS)) == 14
    assert sum(1 for _ in open_source(tmp_path / "run" / rundir.PLAN)) == 14


# Known positions


def known_positions(folder: Path) -> Path:
    """Two who walk side by side, and one who comes towards them, five times a second."""
    lines = ["frame,id,x,y"]
    for k in range(1, 61, 2):
        lines += [f"{k},{i},{x:.3f},{y:.3f}" for i, (x, y) in enumerate(walking(k), start=1)]
    path = folder / "known.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("kind", ["pairs", "intensity"])
def test_groups_are_found_among_known_positions(kind: str, tmp_path: Path) -> None:
    file = known_positions(tmp_path)
    out = tmp_path / "out"
    words = ["--positions", file, "--fps", f"{RATE:g}", "--out", out, "--json"]
    document = phdtrack("groups", *words, "--set", f"groups.kind={kind}").object
    assert {path.name for path in out.iterdir()} == {
        "groups.csv", "members.csv", "events.csv", "warnings.csv",
    }  # fmt: skip
    assert document["groups"]["people_mean"] == pytest.approx(3)
    assert document["groups"]["frames"] == 30
    with (out / "members.csv").open() as lines:
        rows = [row for row in csv.DictReader(lines) if row["frame"] == "59"]
    group = {row["member"]: row["group"] for row in rows}
    assert group["1"] == group["2"] != group["3"]
    with (out / "groups.csv").open() as lines:
        last = [row for row in csv.DictReader(lines) if row["frame"] == "59"]
    pair = next(row for row in last if row["group"] == group["1"])
    # The velocities are slopes of the positions, and times those of the frame numbers.
    assert float(pair["vx"]) == pytest.approx(1.2, abs=0.01)
    assert float(pair["time"]) == pytest.approx(5.8)
    assert float(pair["count"]) == 2


def test_an_empty_file_of_positions_has_no_groups(tmp_path: Path) -> None:
    (tmp_path / "empty.csv").write_text("")
    words = ["--positions", tmp_path / "empty.csv", "--fps", "10", "--out", tmp_path / "out"]
    said = phdtrack("groups", *words, "--json")
    assert said.status == 0, said
    assert said.object["groups"]["frames"] == 0
    assert said.object["groups"]["people_mean"] is None


def test_positions_need_a_rate_and_nothing_else(tmp_path: Path, street: Path) -> None:
    file = known_positions(tmp_path)
    said = refused("groups", "--positions", file, "--out", tmp_path / "a")
    assert "the rate of the frame numbers is not known" in said
    assert "--fps" in said
    for words in (
        ["--detections", street / "det.txt"],
        ["--camera", street / "camera.toml"],
        [street / "street.mp4"],
    ):
        said = refused("groups", "--positions", file, "--fps", "10", *words)
        assert "is given, too" in said
