"""`phdtrack evaluate`: the keys, the table, and every way to use it wrongly."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from cli_runner import phdtrack, refused, walkers

KEYS = [
    "MODA",
    "N_MODA",
    "MODP",
    "MOTA",
    "MOTA_log",
    "MOTP",
    "IDF1",
    "HOTA",
    "OSPA",
    "GOSPA",
    "OSPA2",
    "SFDA",
    "ATA",
]
KEYS += ["id_switches", "misses", "false_positives", "fragments", "frames"]


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    return walkers(tmp_path / "seq") / "gt" / "gt.txt"


def test_json_is_one_object_with_all_keys(truth: Path) -> None:
    said = phdtrack("evaluate", "--truth", truth, "--tracks", truth, "--json")
    assert said.status == 0
    assert list(said.object)[: len(KEYS)] == KEYS
    assert (
        said.object["MOTA"],
        said.object["OSPA"],
        said.object["misses"],
        said.object["frames"],
    ) == (1, 0, 0, 40)
    # Without --json a table for people.
    table = phdtrack("evaluate", "--truth", truth, "--tracks", truth).out
    lines = {line.split()[0]: line.split()[1] for line in table.splitlines() if line[:1].isalpha()}
    assert set(KEYS) <= set(lines)
    assert (lines["MOTA"], lines["frames"]) == ("1.000", "40")


def changed(truth: Path, row: Callable[[list[str]], list[str] | None]) -> Path:
    """A file of tracks: the truth's rows as ``row`` gives them, None for no row."""
    rows = filter(None, (row(line.split(",")) for line in truth.read_text().split()))
    tracks = truth.with_name("tracks.txt")
    tracks.write_text("\n".join(",".join(each) for each in rows))
    return tracks


def moved(row: list[str], right: float, down: float = 0.0) -> list[str]:
    return [*row[:2], str(float(row[2]) + right), str(float(row[3]) + down), *row[4:]]


def test_the_threshold_is_used(truth: Path) -> None:
    # 6 of 24 pixels: an overlap of 18 / 30 = 0.6.
    asked = (
        "evaluate",
        "--truth",
        truth,
        "--tracks",
        changed(truth, lambda row: moved(row, 6)),
        "--json",
        "--iou",
    )
    low, high = (phdtrack(*asked, iou).object for iou in (0.5, 0.7))
    assert (low["MOTA"], low["MOTP"]) == (1, pytest.approx(0.6))
    assert (high["MOTA"], high["MOTP"]) == (-1, None)


def test_t_gospa_is_asked_for(truth: Path) -> None:
    """One track is cut in two, which costs γ, and one is lost."""

    def cut(row: list[str]) -> list[str] | None:
        return None if row[1] == "2" else [row[0], "99" if int(row[0]) > 20 else "1", *row[2:]]

    tracks = changed(truth, cut)
    found = phdtrack("evaluate", "--truth", truth, "--tracks", tracks, "--t-gospa", "--json").object
    assert found["TGOSPA_switching"] == pytest.approx(1 / 40)
    assert found["TGOSPA_missed"] == pytest.approx(found["misses"] / 2 / 40)
    assert (found["TGOSPA_localisation"], found["TGOSPA_false"]) == pytest.approx((0, 0), abs=1e-9)
    assert found["TGOSPA"] == pytest.approx(found["GOSPA"] + 1 / 40)
    said = phdtrack("evaluate", "--truth", truth, "--tracks", tracks, "--t-gospa")
    lines = {
        line.split()[0]: line.split()[1] for line in said.out.splitlines() if line[:1].isalpha()
    }
    assert lines["TGOSPA"] == f"{found['TGOSPA']:.3f}"
    assert (
        "TGOSPA" not in phdtrack("evaluate", "--truth", truth, "--tracks", tracks, "--json").object
    )


def test_rmse_per_object(truth: Path) -> None:
    """The first walker is 3 pixels to the right and 4 down, the second is not found."""
    tracks = changed(truth, lambda row: moved(row, 3, 4) if row[1] == "1" else None)
    asked = ("evaluate", "--truth", truth, "--tracks", tracks, "--rmse", 20)
    found = phdtrack(*asked, "--json").object["RMSE"]
    assert found["overall"] == pytest.approx(5)
    one, other = found["objects"]
    assert (one["identity"], one["frames"], one["mapped"]) == (1, 40, 40)
    assert one["rmse_axis"] == pytest.approx([3, 4])
    assert (other["identity"], other["rmse"], other["rmse_axis"]) == (2, None, [None, None])
    lines = [line.split() for line in phdtrack(*asked).out.splitlines()]
    assert ["1", "40", "40", "3.00", "4.00", "5.00"] in lines
    assert ["all", "80", "40", "5.00"] in lines
    assert "RMSE" not in phdtrack(*asked[:-2], "--json").object


def test_frames_without_any_box_count_where_seqinfo_names_them(truth: Path) -> None:
    info = truth.parents[1] / "seqinfo.ini"
    info.write_text(info.read_text().replace("seqLength=40", "seqLength=50"))
    assert (
        phdtrack("evaluate", "--truth", truth, "--tracks", truth, "--json").object["frames"] == 50
    )
    assert (
        phdtrack("evaluate", "--truth", truth, "--tracks", truth, "--frames", 45, "--json").object[
            "frames"
        ]
        == 45
    )
    empty = truth.with_name("empty.txt")
    empty.write_text("")
    assert (
        "the truth holds no object" in phdtrack("evaluate", "--truth", empty, "--tracks", truth).err
    )


@pytest.mark.parametrize("iou", [0, -1, 1.5, "nan"])
def test_impossible_threshold(truth: Path, iou: object) -> None:
    assert "iou" in refused("evaluate", "--truth", truth, "--tracks", truth, "--iou", iou, "--json")


def test_what_does_not_count(truth: Path) -> None:
    """A false track in a corner that is ignored, or in a DontCare region of KITTI's label file."""
    tracks, listed, labels = (
        truth.with_name(name) for name in ("tracks.txt", "ignore.csv", "labels.txt")
    )
    corner = [f"{k},77,300,200,9,9,1,-1,-1,-1" for k in range(1, 6)]
    tracks.write_text("\n".join([truth.read_text().strip(), *corner]))
    listed.write_text("frame,x,y,w,h\n,290,190,30,30\n")
    asked = ("evaluate", "--tracks", tracks, "--json", "--truth")
    assert phdtrack(*asked, truth).object["false_positives"] == 5
    assert phdtrack(*asked, truth, "--ignore", listed, "--errors").object["errors"]["ignored"] == 5
    rows = [[float(cell) for cell in line.split(",")[:6]] for line in truth.read_text().split()]
    lines = [
        f"{k - 1:.0f} {i:.0f} Car 0 0 0 {x} {y} {x + w} {y + h} 1 1 1 0 0 0 0"
        for k, i, x, y, w, h in rows
    ]
    lines += [f"{k} -1 DontCare -1 -1 -10 290 190 320 220 1 1 1 0 0 0 0" for k in range(4)]
    labels.write_text("\n".join(lines))
    found = phdtrack(*asked, labels, "--kitti", "Car").object
    # Boxes of up to 25 pixels are not looked at, and the walkers are higher.
    assert (found["misses"], found["false_positives"]) == (0, 0)
    # The only type needs no name; of several one has to be named.
    assert phdtrack(*asked, labels).object == found
    labels.write_text("\n".join([*lines, "0 9 Van 0 0 0 1 1 60 60 1 1 1 0 0 0 0"]))
    assert "--kitti" in refused(*asked, labels)


def test_errors_by_cause(truth: Path) -> None:
    """The second walker is missed, detected in half of the frames; a false track stands in the
    corner.
    """
    rows = [line.split(",") for line in truth.read_text().split()]
    tracks = truth.with_name("tracks.txt")
    seen = truth.with_name("seen.txt")
    corner = [f"{k},77,300,200,9,9,1,-1,-1,-1" for k in range(1, 6)]
    tracks.write_text("\n".join([",".join(row) for row in rows if row[1] == "1"] + corner))
    seen.write_text(
        "\n".join(f"{row[0]},-1,{','.join(row[2:6])},1" for row in rows if int(row[0]) <= 20)
    )
    asked = ("evaluate", "--truth", truth, "--tracks", tracks, "--errors", "--detections", seen)
    found = phdtrack(*asked, "--json").object
    errors = found["errors"]
    assert errors["misses"]["undetected"] == {"never": 20, "head": 0, "gap": 0, "tail": 0}
    assert errors["misses"]["unused"]["never"] == 20
    assert errors["false_positives"] == {"loose": 0, "ghost": 0, "duplicate": 0, "clutter": 5}
    assert (found["misses"], found["false_positives"]) == (40, 5)
    assert errors["worst_objects"][0]["last"] == 0
    lines = [line.split() for line in phdtrack(*asked).out.splitlines()]
    assert ["undetected", "20", "0", "0", "0", "20"] in lines
    assert ["all", "40", "0", "0", "0", "40"] in lines
    assert ["0", "0", "0", "5", "5"] in lines
    assert ["2", "40", "40", "20", "20", "40", "0", "0", "0", "0"] in lines
    assert ["77", "5", "5", "0", "0", "0", "5", "0"] in lines
    assert "errors" not in phdtrack(*asked[:5], "--json").object
    brief = phdtrack(*asked, "--worst", 0).out
    assert "Misses by cause" in brief
    assert "most misses" not in brief


def test_errors_of_identity(truth: Path) -> None:
    """The two walkers' tracks exchange them at frame 31; the second one's has another name in the
    first ten frames.
    """

    def name(row: list[str]) -> list[str]:
        frame = int(row[0])
        other = {"1": "2", "2": "1"}[row[1]]
        if row[1] == "2" and frame <= 10:
            other = "3"
        return [row[0], other if frame > 30 or other == "3" else row[1], *row[2:]]

    asked = ("evaluate", "--truth", truth, "--tracks", changed(truth, name), "--errors")
    found = phdtrack(*asked, "--json").object
    assert found["errors"]["identity"] == {"swaps": 1, "transfers": 0, "breaks": 1}
    assert found["id_switches"] == 3
    worst = found["errors"]["worst_identity"]
    assert [(each["kind"], each["frame"], each["boxes"]) for each in worst] == [
        ("swap", 31, 20),
        ("break", 11, 10),
    ]
    assert (sorted(worst[0]["objects"]), sorted(worst[0]["tracks"])) == ([1, 2], [1, 2])
    assert (worst[1]["objects"], worst[1]["tracks"]) == ([2], [3, 2])
    lines = [line.split() for line in phdtrack(*asked).out.splitlines()]
    place = lines.index(["swaps", "transfers", "breaks"])
    assert lines[place + 1] == ["1", "0", "1"]
    assert ["break", "11", "2", "3", "to", "2", "10"] in lines
    assert ["swap", "31"] in [line[:2] for line in lines]
    labelled = phdtrack(*asked, "--labelled", "1,9,11,21,31,40", "--json").object
    frames = [each["frame"] for each in labelled["errors"]["worst_identity"]]
    assert sorted(frames) == [11, 31]
    brief = phdtrack(*asked, "--worst", 0).out
    assert "The worst of them" not in brief


def test_detections_without_errors_are_refused(tmp_path: Path) -> None:
    given = ("--truth", tmp_path / "gt.txt", "--tracks", tmp_path / "tracks.csv")
    for more in (("--detections", tmp_path / "none.txt"), ("--worst", 3)):
        assert f"{more[0]}: it goes with --errors only" in refused("evaluate", *given, *more)
