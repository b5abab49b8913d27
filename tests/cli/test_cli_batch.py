"""`phdtrack batch`: the same by processes and by shards; what dies, fails or is stopped loses
nothing; the data set.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow
import pytest
from cli_runner import phdtrack, refused, walkers
from pyarrow import parquet

from phdtrack.errors import InputError
from phdtrack.formats import TracksWriter, read_tracks
from phdtrack.run.parquet_rows import write_rows
from phdtrack.run.video_batch import expanded, left_out, names
from phdtrack.types import Tracks
from phdtrack.video import VideoWriter

pytestmark = pytest.mark.slow

OPTIONS = ("--", "--no-video", "--filter", "gm-phd", "--fps", "25", "--checkpoint-every", "0.001")


def clip(path: Path, seed: int, frames: int = 30) -> None:
    """A dark box that crosses a noisy grey."""
    rng = np.random.default_rng(seed)
    ground = rng.integers(120, 136, (96, 160, 3))
    top = 5 + seed % 40
    with VideoWriter(path, 160, 96, 25.0) as writer:
        for k in range(frames):
            image = (ground + rng.integers(-2, 3, ground.shape)).astype(np.uint8)
            image[top : top + 40, 5 + 4 * k : 21 + 4 * k] = 30
            writer.write(image)


@pytest.fixture(scope="module", params=[4, pytest.param(64, marks=pytest.mark.slow)])
def clips(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Short videos in a folder."""
    folder = tmp_path_factory.mktemp("clips")
    for k in range(request.param):
        clip(folder / f"clip{k:02d}.mp4", k)
    return folder


def count(clips: Path) -> int:
    return len(list(clips.glob("*.mp4")))


@pytest.fixture(scope="module")
def whole(clips: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The batch that nothing stopped, by two processes."""
    out = tmp_path_factory.mktemp("whole") / "all"
    said = phdtrack("batch", clips, "--out", out, "--jobs", 2, *OPTIONS)
    assert said.status == 0, said.err
    assert f"{count(clips)} videos: {count(clips)} now, 0 before, 0 failed." in said.out
    return out


def same(out: Path, whole: Path) -> None:
    """Every video once, with the same rows, and nothing half done."""
    for folder in ("runs", "tracks"):
        assert {path.name for path in (out / folder).iterdir()} == {
            path.name for path in (whole / folder).iterdir()
        }
    for table in (whole / "tracks").iterdir():
        assert (out / "tracks" / table.name).read_bytes() == table.read_bytes()
        run = Path("runs") / table.stem
        for name in ("tracks.csv", "tracks_online.csv", "states.csv", "detections.csv"):
            assert (out / run / name).read_bytes() == (whole / run / name).read_bytes()
        assert not [
            path for path in (out / run).iterdir() if path.suffix in (".part", ".log", ".detector")
        ]
    rows = parquet.read_table(out / "tracks").select(["video", "frame", "identity"]).to_pylist()
    assert len(rows) == len({tuple(row.values()) for row in rows})


def summary(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "batch.json").read_text())
    return found


def states(out: Path) -> dict[str, str]:
    return {one["video"]: one["state"] for one in summary(out)["videos"]}


def test_the_data_set_has_the_rows_of_all_runs(clips: Path, whole: Path) -> None:
    table = parquet.read_table(whole / "tracks")
    assert table["video"].unique().to_pylist() == [f"clip{k:02d}" for k in range(count(clips))]
    for name in ("clip00", "clip03"):
        rows = table.filter(np.equal(table["video"].to_numpy(), name))
        tracks = read_tracks(whole / "runs" / name / "tracks.csv")
        assert len(tracks) > 10
        assert rows["identity"].to_pylist() == tracks.identity.tolist()
        np.testing.assert_allclose(rows["time"].to_numpy(), (tracks.frame - 1) / 25, atol=1e-6)
        box = np.stack([rows[one].to_numpy() for one in ("left", "top", "width", "height")], axis=1)
        np.testing.assert_array_equal(np.hstack([box[:, :2], box[:, :2] + box[:, 2:]]), tracks.xyxy)
    found = summary(whole)
    assert (found["complete"], found["failed"], found["reused"]) == (True, [], 0)
    assert {one["frames"] for one in found["videos"]} == {30}
    assert sum(one["track_rows"] for one in found["videos"]) == table.num_rows


def test_shards_do_the_same_and_a_last_call_sums_up(
    clips: Path, whole: Path, tmp_path: Path
) -> None:
    for k in (1, 2, 3):
        assert (
            phdtrack(
                "batch",
                clips,
                "--out",
                tmp_path / "all",
                "--jobs",
                1,
                "--shard",
                f"{k}/3",
                *OPTIONS,
            ).status
            == 0
        )
    same(tmp_path / "all", whole)
    shares = [
        json.loads(path.read_text())["videos"]
        for path in sorted((tmp_path / "all").glob("batch-*-of-3.json"))
    ]
    assert sorted(one["video"] for share in shares for one in share) == sorted(states(whole))
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "all").rglob("*.csv")}
    said = phdtrack("batch", clips, "--out", tmp_path / "all", "--json", *OPTIONS)
    assert (said.status, said.object["reused"], said.object["complete"]) == (0, count(clips), True)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "all").rglob("*.csv")} == before
    assert [one["frames"] for one in summary(tmp_path / "all")["videos"]] == [30] * count(clips)


@contextmanager
def started(*words: object) -> Iterator[subprocess.Popen[str]]:
    """The command in a process of its own."""
    command = [sys.executable, "-m", "phdtrack", *map(str, words)]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        try:
            yield child
        finally:
            child.kill()


def workers(child: subprocess.Popen[str]) -> list[int]:
    """Its processes that do the work."""
    found = []
    for number in Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split():
        words = Path(f"/proc/{number}/cmdline").read_bytes()
        if b"spawn_main" in words:
            found.append(int(number))
    return found


def until(what: Callable[[], object], seconds: float = 120.0) -> None:
    begun = time.monotonic()
    while not what():
        assert time.monotonic() - begun < seconds
        time.sleep(0.002)


def under_way(out: Path) -> list[Path]:
    """Runs that have begun to write frames."""
    return [path.parent for path in out.glob("runs/*/states.csv.part") if path.stat().st_size > 400]


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_a_killed_worker_loses_its_own_video_only(clips: Path, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "all"
    with started("batch", clips, "--out", out, "--jobs", 1, *OPTIONS) as child:
        until(lambda: len(list(out.glob("tracks/*.parquet"))) >= 2 and under_way(out))
        os.kill(workers(child)[0], signal.SIGKILL)
        said, errors = child.communicate(timeout=600)
    assert child.returncode == 1, errors
    failed = [one for one in summary(out)["videos"] if one["state"] == "failed"]
    assert [one["error"] for one in failed] == ["its process died (out of memory?)"]
    assert f"{count(clips) - 1} now, 0 before, 1 failed" in said
    assert list(states(out).values()).count("done") == count(clips) - 1
    assert not (out / "tracks" / f"{failed[0]['video']}.parquet").exists()
    again = phdtrack("batch", clips, "--out", out, "--json", *OPTIONS)
    assert (again.status, again.object["reused"]) == (0, count(clips) - 1)
    same(out, whole)


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
@pytest.mark.parametrize(
    ("name", "status"),
    [("SIGINT", 130), pytest.param("SIGKILL", -signal.SIGKILL, marks=pytest.mark.slow)],
)
def test_a_batch_that_is_stopped_leaves_no_process_and_goes_on(
    name: str, status: int, clips: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "all"
    with started("batch", clips, "--out", out, "--jobs", 2, *OPTIONS) as child:
        until(lambda: list(out.glob("tracks/*.parquet")) and under_way(out))
        left = workers(child)
        assert left
        child.send_signal(getattr(signal, name))
        assert child.wait(60) == status
    until(lambda: not any(Path(f"/proc/{number}").exists() for number in left), 20)
    if name == "SIGINT":
        assert not summary(out)["complete"]
        assert "missing" in states(out).values()
    again = phdtrack("batch", clips, "--out", out, "--json", *OPTIONS)
    assert again.status == 0
    assert 1 <= again.object["reused"] < count(clips)
    same(out, whole)


@pytest.fixture
def two(tmp_path: Path) -> Path:
    """Two sequences of detections, a/det.txt and b/det.txt with a seqinfo.ini, in the folder that
    is given.
    """
    for name in "ab":
        shutil.move(walkers(tmp_path / name) / "det" / "det.txt", tmp_path / name / "det.txt")
    return tmp_path


def test_a_failed_video_does_not_stop_the_others(two: Path) -> None:
    out = two / "all"
    bad = two / "bad.mp4"
    bad.write_text("no video")
    words = ("batch", two / "a/det.txt", bad, two / "absent.mp4", "--out", out, "--jobs", 2)
    said = phdtrack(*words)
    assert said.status == 1
    assert "1 now, 0 before, 2 failed" in said.out
    reasons = {one["video"]: one["error"] for one in summary(out)["videos"]}
    assert (reasons["det"], states(out)["det"], summary(out)["failed"]) == (
        None,
        "done",
        ["bad", "absent"],
    )
    assert "cannot be read as a video" in reasons["bad"]
    assert "there is no such file" in reasons["absent"]
    assert reasons["bad"] in said.err.replace("phdtrack: warning: ", "")
    clip(bad, 1)
    clip(two / "absent.mp4", 2)
    assert "2 now, 1 before, 0 failed" in phdtrack(*words).out


def test_options_of_track_follow_and_are_a_part_of_what_decides(
    two: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(two)
    for name in "ab":
        clip(two / f"{name}.mp4", 3)
        text = (two / name / "det.txt").read_text()
        (two / f"{name}.txt").write_text(text)
    words = ("batch", "a.mp4", "b.mp4", "--out", "all", "--json", "--")
    given = ("--detections", "{}.txt", "--no-video", "--seed", "3", "--frame-size", "160x96")
    assert phdtrack(*words, *given).object["complete"]
    about = json.loads(Path("all/runs/b/run.json").read_text())
    assert (about["input"]["detections"], about["seed"]) == (str(two / "b.txt"), 3)
    words_of_it = " ".join(given).replace("{}", "b")
    assert (
        about["command"]
        == f"phdtrack track {two / 'b.mp4'} --out {two / 'all/runs/b'} {words_of_it}"
    )
    assert phdtrack(*words, *given).object["reused"] == 2
    assert "2 runs there (a, …) had other options" in refused(*words, *given, "--filter", "none")
    # A file among the options that has changed counts, too: of one video.
    rows = Path("b.txt").read_text().splitlines(keepends=True)
    Path("b.txt").write_text("".join(rows[:40]))
    assert "1 run there (b, …)" in refused(*words, *given)
    before = parquet.read_table("all/tracks/b.parquet")
    found = phdtrack(*words[:-1], "--overwrite", "--", *given).object
    assert (found["reused"], found["complete"]) == (1, True)
    assert parquet.read_table("all/tracks/b.parquet").num_rows < before.num_rows
    # A run whose folder was removed is missing.
    shutil.rmtree("all/runs/a")
    assert phdtrack(*words, *given).object["reused"] == 1


def test_what_cannot_be_is_refused_before_anything_runs(two: Path) -> None:
    out = two / "all"
    table = two / "a/det.txt"
    for words, sentence in (
        ((table, "--", "--filtr", "none"), "after --: No such option: --filtr"),
        ((table, "--", "other.mp4"), "got other.mp4"),
        ((table, "--", "--out", "x"), "got x"),
        (("rtsp://camera/1",), "phdtrack live"),
        ((two / "*.avi",), "no video and no image"),
        ((two / "a" / "gt",), "no video and no image"),
        ((table, "--shard", "3/2"), "expected a share as 2/8"),
        ((table, "--shard", "half"), "expected a share as 2/8"),
    ):
        assert sentence in refused("batch", "--out", out, *words)
    assert not out.exists()
    assert "local or ray" in phdtrack("batch", table, "--out", out, "--engine", "dask").err


def test_lists_folders_and_patterns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in (
        "in/b.mp4",
        "in/.c.mp4",
        "in/all/runs/b/annotated.mp4",
        "in/deep/a.MKV",
        "in/notes.txt",
        "img/1.png",
        "img/2.png",
        "MOT-02/img1/1.jpg",
    ):
        path = Path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    Path("list.txt").write_text("# of today\nin/b.mp4\n\nin/*.txt\nimg\n")
    assert list(expanded("in")) == ["in/b.mp4", "in/deep/a.MKV"]
    assert list(expanded("in/*")) == ["in/all", "in/b.mp4", "in/deep", "in/notes.txt"]
    assert list(expanded("@list.txt")) == ["in/b.mp4", "in/notes.txt", "img"]
    for one in ("img", "img/*.png", "absent.mp4"):
        assert list(expanded(one)) == [one]
    assert names([f"{tmp_path}/img/*.png", f"{tmp_path}/MOT-02/img1", f"{tmp_path}/v1.2.mp4"]) == [
        "img",
        "MOT-02",
        "v1.2",
    ]
    assert names(["/data/n/1.mp4", "/data/s/1.mp4", "/data/s/_2.mp4"]) == ["n-1", "s-1", "s-_2"]
    with pytest.raises(InputError, match=r"would both be called data-s-1"):
        names(["/data/s/1.mp4", "/data/s/1.avi"])


def test_a_folder_has_what_track_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("in").mkdir()
    videos = ["a.mp4", "b.3gp", "c.m2ts", "d.asf", "e.h264", "g.gif", "i.divx"]
    for name in (*videos, "notes.txt", "thumb.png", "a.srt", "z.bin", ".h.mp4", "._a.mp4"):
        Path("in", name).write_bytes(b"?")
    with VideoWriter(Path("in/other.dav"), 64, 48, 10) as video:
        video.write(np.zeros((48, 64, 3), np.uint8))
    assert list(expanded("in")) == [f"in/{name}" for name in sorted([*videos, "other.dav"])]
    assert left_out("in") == "in: left out a.srt, notes.txt, thumb.png and 1 more"
    assert left_out("in/a.mp4") == ""


def test_a_folder_of_sequences_is_many_videos(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in (
        "in/A/img1/1.jpg",
        "in/A/img1/2.jpg",
        "in/A/gt/gt.txt",
        "in/B/1.png",
        "in/B/.2.png",
    ):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()
    assert list(expanded("in")) == ["in/A/img1", "in/B"]
    assert left_out("in") == "in: left out A/gt/gt.txt"
    Path("in/B/copy.mp4").write_bytes(b"?")
    for k in range(9):
        Path(f"in/B/{k}.png").touch()
    assert list(expanded("in/B")) == ["in/B"]
    assert left_out("in/B") == "in/B: left out copy.mp4"


def test_places_classes_and_times_are_in_the_rows(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    file = tmp_path / "rows" / "yard.parquet"
    folder.mkdir(parents=True)
    boxes = np.array([[10, 10, 20, 40.5], [12, 10, 22, 40], [90, 9, 95, 30], [14, 10, 24, 40]])
    tracks = Tracks.of([1, 3, 3, 6], [1, 1, 2, 1], boxes, 0.5, [0, 0, 1, -1])
    tracks = replace(tracks, class_id=np.array([0, 0, 2, 0]))
    with TracksWriter(folder / "tracks.csv", {2: "big car"}) as writer:
        writer.append(tracks, np.array([[0.5, 0.0, np.nan, 2.5], [7.0, -1.0, np.nan, 1.0]]))
    (folder / "states.csv").write_text("frame,time,weight\n2,0.1,1\n4,0.5,1\n4,0.5,1\n")
    write_rows("yard", folder, file, 10.0)
    rows = parquet.read_table(file).to_pydict()
    np.testing.assert_allclose(rows["time"], [0.0, 0.3, 0.3, 0.7])
    assert (rows["x"], rows["y"]) == ([0.5, 0.0, None, 2.5], [7.0, -1.0, None, 1.0])
    assert rows["class"] == ["0", "0", "big car", "0"]
    assert (rows["video"], rows["height"], rows["frame"]) == (
        ["yard"] * 4,
        [30.5, 30.0, 21.0, 30.0],
        [1, 3, 3, 6],
    )
    kinds = parquet.read_schema(file)
    (folder / "tracks.csv").write_text("")
    (folder / "states.csv").write_text("frame,time,weight\n")
    write_rows("yard", folder, file, 10.0)
    assert parquet.read_table(file).num_rows == 0
    assert parquet.read_schema(file).equals(kinds)


def test_the_queries_of_the_page_answer_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody who goes right over the turn of the hour, and somebody who leaves and comes back."""
    monkeypatch.chdir(tmp_path)
    one = [(1, float(t), 300.0 + 2 * (t - 3590)) for t in range(3590, 3611)]
    other = [
        (2, float(t), x)
        for t, x in ((10, 200), (11, 200), (12, 200), (13, 500), (20, 200), (21, 200))
    ]
    rows = [
        {"video": "gate-2026-11-24T05", "frame": int(t) + 1, "time": t, "identity": who}
        | {"left": x - 10.0, "top": 150.0, "width": 20.0, "height": 50.0}
        for who, t, x in one + other
    ]
    Path("all/tracks").mkdir(parents=True)
    parquet.write_table(pyarrow.Table.from_pylist(rows), "all/tracks/gate.parquet")
    videos = [
        {"video": "gate", "state": "done", "error": None},
        {"video": "door", "state": "failed", "error": "no video"},
    ]
    Path("all/batch.json").write_text(json.dumps({"videos": videos}))
    page = (Path(__file__).parents[2] / "docs/how-to/batch.md").read_text(encoding="utf-8")
    hours, clock, visits, line, flows, failed = (
        duckdb.sql(text).fetchall()
        for text in re.findall(r"^```sql\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    )
    gate = rows[0]["video"]
    assert hours == [(gate, 0, 2), (gate, 1, 1)]
    assert [(str(hour), objects) for hour, objects in clock] == [
        ("2026-11-24 05:00:00", 2),
        ("2026-11-24 06:00:00", 1),
    ]
    assert visits == [(gate, 1, 3590.0, 20.0), (gate, 2, 10.0, 2.0), (gate, 2, 20.0, 1.0)]
    assert line == [(gate, 0, 1, 1), (gate, 1, 1, 0)]
    assert flows == [(gate, [1, 1], [1, 1], 1), (gate, [1, 1], [2, 1], 1)]
    assert failed == [("door", "no video")]


@pytest.mark.filterwarnings("ignore")
def test_a_ray_cluster_does_the_same_also_where_a_machine_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three nodes, groups of processes with one CPU each; 64 videos, six of them so long that all
    are busy at once.
    """
    pytest.importorskip("ray", reason="Ray is not installed (pip install 'phdtrack[ray]')")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    from ray.cluster_utils import Cluster

    clips = tmp_path / "clips"
    whole = tmp_path / "whole"
    out = tmp_path / "all"
    clips.mkdir()
    for k in range(64):
        clip(clips / f"clip{k:02d}.mp4", k, 1200 if k < 6 else 30)
    assert phdtrack("batch", clips, "--out", whole, *OPTIONS).status == 0
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
        with started(
            "batch", clips, "--out", out, "--engine", "ray", "--address", cluster.address, *OPTIONS
        ) as child:
            until(lambda: len(under_way(out)) >= 3)
            cluster.remove_node(nodes[0], allow_graceful=False)
            said, errors = child.communicate(timeout=900)
        assert child.returncode == 0, errors
        assert f"{count(clips)} now, 0 before, 0 failed" in said
        same(out, whole)
    finally:
        cluster.shutdown()


def test_that_kernels_are_compiled_is_said_at_once(
    two: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    with started("batch", two / "a/det.txt", "--out", two / "all", *OPTIONS) as child:
        assert child.stderr is not None
        assert any("phdtrack compiles its kernels" in line for line in child.stderr)
        child.terminate()
        child.communicate(timeout=60)


def test_without_a_cluster_the_command_that_starts_one_is_named(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="Ray is not installed (pip install 'phdtrack[ray]')")
    clip(tmp_path / "a.mp4", 1)
    said = refused("batch", tmp_path / "a.mp4", "--out", tmp_path / "all", "--engine", "ray")
    assert "ray start --head" in said


def test_without_ray_the_line_that_installs_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    clip(tmp_path / "a.mp4", 1)
    said = refused("batch", tmp_path / "a.mp4", "--out", tmp_path / "all", "--engine", "ray")
    assert "pip install 'phdtrack[ray]'" in said


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_overwrite_begins_anew_what_cannot_go_on(clips: Path, whole: Path, tmp_path: Path) -> None:
    """As where another version of phdtrack has left the checkpoint."""
    out = tmp_path / "all"
    words = ("batch", clips / "clip01.mp4", "--out", out)
    with started(*words, *OPTIONS) as child:
        until(lambda: list(out.glob("runs/*/checkpoint.detector")))
        # The worker itself: one that outlives the command may complete the run, or write the
        # checkpoint anew.
        os.kill(workers(child)[0], signal.SIGKILL)
        child.communicate(timeout=600)
    (out / "runs" / "clip01" / "checkpoint.detector").write_bytes(b"damaged")
    said = phdtrack(*words, *OPTIONS)
    assert (said.status, "Say --overwrite to begin anew" in said.err) == (1, True)
    assert phdtrack(*words, "--overwrite", *OPTIONS).status == 0
    table = Path("tracks") / "clip01.parquet"
    assert (out / table).read_bytes() == (whole / table).read_bytes()
