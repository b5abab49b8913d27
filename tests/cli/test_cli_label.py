"""``phdtrack label`` as a user starts and leaves it; the page itself is tested in tests/label."""

import json
import re
import shlex
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli_runner import phdtrack

from phdtrack.label import LabelStore


@pytest.fixture
def sequence(tmp_path):
    """A folder of 30 pictures with a bright square that moves, and detections of it."""
    folder = tmp_path / "street"
    folder.mkdir()
    rows = []
    for k in range(30):
        image = np.full((120, 160, 3), 40, np.uint8)
        image[50:80, 10 + 4 * k : 30 + 4 * k] = 220
        cv2.imwrite(str(folder / f"{k + 1:06d}.png"), image)
        rows.append(f"{k + 1},-1,{10 + 4 * k},50,20,30,0.9,-1,-1,-1")
    (tmp_path / "det.txt").write_text("\n".join(rows) + "\n")
    return tmp_path


class Started:
    """The command in a process of its own."""

    def __init__(self, *arguments, cwd):
        program = [sys.executable, "-m", "phdtrack", "label", *arguments, "--no-browser"]
        self.process = subprocess.Popen(
            program, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.told = ""
        while "the page: " not in self.told:
            line = self.process.stdout.readline()
            assert line, self.process.communicate()
            self.told += line
        self.url = re.search(r"http://\S+", self.told)[0]

    def ask(self, path, sent=None):
        data = None if sent is None else json.dumps(sent).encode()
        request = urllib.request.Request(self.url + path, data, {"X-Phdtrack": "1"})
        with urllib.request.urlopen(request, timeout=30) as answer:
            return answer.read()

    def leave(self):
        self.process.send_signal(signal.SIGINT)
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, self.told + out, err


@pytest.mark.slow
def test_label_leave_and_go_on(sequence):
    arguments = ("street", "--detections", "det.txt", "--frames", "8", "--seed", "3")
    page = Started(*arguments, cwd=sequence)
    assert "8 frames, 0 of them done; the marks are kept in runs/street.labels.sqlite" in page.told
    overview = json.loads(page.ask("api/overview"))
    assert (overview["width"], overview["height"], len(overview["frames"])) == (160, 120, 8)
    first = overview["frames"][0]["number"]
    picture = cv2.imdecode(np.frombuffer(page.ask(f"still/{first}.jpg"), np.uint8), 1)
    assert picture[65, 20 + 4 * (first - 1)].min() > 180
    page.ask(f"api/frame/{first}/marks", {"marks": [{"frame": first, "box": 0, "mark": "false"}]})
    page.ask(f"api/frame/{first}/done", {})
    status, out, _ = page.leave()
    assert status == 0
    kept = Path("runs/street.labels.sqlite")
    assert f"1 of 8 frames done, 1 false, no births: {kept}" in out
    command = f"phdtrack learn street --detections det.txt --labels {kept}"
    assert f"the same command continues; when all are done, run: {command}" in out
    # Nothing is written beside the video.
    assert sorted(path.name for path in sequence.iterdir()) == ["det.txt", "runs", "street"]

    # What a browser has kept for the page is found again: it is at the same address, unless that is
    # taken.
    again = Started(*arguments, cwd=sequence)
    assert again.url == page.url
    third = Started(*arguments, cwd=sequence)
    third.leave()
    assert third.url != page.url
    assert "8 frames, 1 of them done" in again.told
    overview_again = json.loads(again.ask("api/overview"))
    again.leave()
    assert [frame["number"] for frame in overview_again["frames"]] == [
        frame["number"] for frame in overview["frames"]
    ]
    assert [(label.frame, label.box) for label in LabelStore(sequence / kept).labels()] == [
        (first, 0)
    ]


@pytest.mark.slow
def test_the_name_of_the_labeller_is_asked_once(sequence):
    """It is given, or typed on the page, for one video, and holds for the next ones."""
    arguments = ("--detections", "det.txt", "--frames", "2", "--frame-size", "160x120")
    page = Started(*arguments, "--fps", "25", "--labeller", "ada", cwd=sequence)
    overview = json.loads(page.ask("api/overview"))
    assert overview["labeller"] == "ada"
    number = overview["frames"][0]["number"]
    page.ask(f"api/frame/{number}/done", {"done": True, "who": "ada"})
    page.leave()
    other = Started("street", *arguments[:4], cwd=sequence)
    assert json.loads(other.ask("api/overview"))["labeller"] == "ada"
    other.leave()
    assert "marks are kept under the name ada" in other.told
    # Others who open the page from elsewhere are somebody else.
    shared = Started("street", *arguments[:4], "--allow-host", "cam.example.org", cwd=sequence)
    assert "under the name" not in shared.told
    shared.leave()


@pytest.mark.slow
def test_a_detector_runs_once(sequence):
    page = Started("street", "--frames", "5", cwd=sequence)
    page.leave()
    kept = list(sequence.glob("runs/street.labels.change-*.detections.csv"))
    assert len(kept) == 1
    again = Started("street", "--frames", "5", cwd=sequence)
    _, _, err = again.leave()
    assert f"the detections are those of runs/{kept[0].name}" in err
    # Another video of this name has others, and the marks are not of these.
    other = sequence / "other" / "street"
    other.mkdir(parents=True)
    for path in (sequence / "street").iterdir():
        cv2.imwrite(str(other / path.name), cv2.imread(str(path))[::-1])
    done = subprocess.run(
        [sys.executable, "-m", "phdtrack", "label", "other/street", "--frames", "5",
         "--no-browser"],
        cwd=sequence, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "these marks were made on other detections" in done.stderr


def test_what_comes_next_is_said_with_the_options_of_then(sequence, monkeypatch):
    """The command at the end finds the marks, and the detections that they are of: it learns from
    them.
    """
    monkeypatch.chdir(sequence)
    cv2.imwrite("mask.png", np.full((120, 160), 255, np.uint8))
    given = (
        "street",
        "--frames",
        "20",
        "--mask",
        "mask.png",
        "--set",
        "detector.min_area=0.001",
        "--no-suggest",
    )
    page = Started(*given, "--labels", "my marks.sqlite", cwd=sequence)
    for frame in json.loads(page.ask("api/overview"))["frames"]:
        answer = json.loads(page.ask(f"api/frame/{frame['number']}/done", {}))
    _, out, _ = page.leave()
    command = re.search(r"^now run: (.*)$", out, re.MULTILINE)[1]
    assert command == answer["progress"]["next"]
    assert (
        command == "phdtrack learn street --mask mask.png --labels 'my marks.sqlite' --set"
        " detector.min_area=0.001"
    )
    done = phdtrack(*shlex.split(command)[1:])
    assert "the detections are those of my marks." in done.err
    assert "false alarms not learned, defaults kept: " in done.out


def test_marks_go_to_other_tools_and_come_back(sequence, monkeypatch):
    monkeypatch.chdir(sequence)
    given = ("label", "--detections", "det.txt", "--frame-size", "160x120", "--fps", "25")
    missed = '<box label="person" xtl="1" ytl="1" xbr="9" ybr="19"/>'
    boxes = '<image id="{0}">{1}<box label="person" xtl="{2}" ytl="50" xbr="{3}" ybr="80"/></image>'
    images = "".join(boxes.format(k, missed * (k == 4), 11 + 4 * k, 31 + 4 * k) for k in range(40))
    Path("theirs.xml").write_text(f"<annotations>{images}</annotations>")
    done = phdtrack(
        *given,
        "--import",
        "theirs.xml",
        "--labeller",
        "eve",
        "--frames",
        "30",
        "--export",
        "marks.json",
    )
    assert done.status == 0, done.err
    assert (
        "imported: no false alarms, 30 objects with a detection, 1 without; no frames done"
        in done.out
    )
    assert "warning: 10 boxes dropped: on frames that are not drawn, see --frames" in done.err
    store = LabelStore(Path("runs/det.labels.sqlite"))
    assert {label.who for label in store.labels()} == {"eve"}
    # What is written goes on with the same frames elsewhere; it leaves those of the file as they
    # are.
    again = phdtrack(*given, "--labels", "other.sqlite", "--import", "marks.json")
    assert (again.status, again.err) == (0, "")
    assert LabelStore(Path("other.sqlite")).labels() == store.labels()
    assert (
        phdtrack(
            *given, "--labels", "other.sqlite", "--seed", "5", "--frames", "3", "--export", "m.xml"
        ).status
        == 0
    )
    assert LabelStore(Path("other.sqlite")).frames() == store.frames()
    assert Path("m.xml").read_text().count("<box") == len(store.labels())
    for options, words in (
        (("--export", "marks.json"), "exists already"),
        (("--export", "marks.txt"), "ends in .json, .xml or .csv"),
        (("--export", "new.json", "--labels", "none.sqlite"), "no such file of labels"),
        (("--import", "det.txt"), "det.txt: expected COCO (JSON) or CVAT (XML)"),
    ):
        done = phdtrack(*given, *options)
        assert done.status == 2
        assert words in done.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "nothing to label"),
        (("nowhere.mp4",), "nowhere.mp4"),
        (("street", "--detections", "none.txt"), "none.txt"),
        (
            ("street", "--detections", "det.txt", "--labels", "nowhere/labels"),
            "cannot be used as a file of labels",
        ),
        (
            ("street", "--detections", "det.txt", "--labels", "det.txt"),
            "cannot be used as a file of labels",
        ),
        (("0",), "a camera"),
    ],
)
def test_mistakes_are_told(sequence, monkeypatch, arguments, words):
    monkeypatch.chdir(sequence)
    done = phdtrack("label", *arguments, "--no-browser")
    assert done.status == 2
    assert words in done.err
    # Guesses about the pictures may be told before; the mistake is one line.
    assert sum("warning: " not in line for line in done.err.splitlines()) == 1


def suggested(*arguments, cwd):
    """What a page that was started suggests once it is ready."""
    page = Started(*arguments, cwd=cwd)
    for _ in range(600):
        found = json.loads(page.ask("api/suggestions"))
        if found["ready"]:
            break
        time.sleep(0.1)
    page.leave()
    return found


@pytest.mark.slow
def test_suggestions_come_while_the_page_is_open(tmp_path):
    """A place that fires, and somebody who walks by: the page answers at once, and is told of the
    place a little later.
    """
    rng = np.random.default_rng(0)
    rows = [f"{k},-1,{20 + 0.5 * k},60,20,40,1,-1,-1,-1" for k in range(1, 401)]
    for k in np.flatnonzero(rng.random(400) < 0.5) + 1:
        left, top = np.array([200.0, 20]) + rng.normal(0, 1.5, 2)
        rows.append(f"{k},-1,{left:.1f},{top:.1f},24,24,1,-1,-1,-1")
    (tmp_path / "det.txt").write_text(
        "\n".join(sorted(rows, key=lambda row: int(row.split(",")[0]))) + "\n"
    )
    arguments = (
        "--detections",
        "det.txt",
        "--frame-size",
        "320x240",
        "--fps",
        "25",
        "--frames",
        "10",
    )
    told = suggested(*arguments, cwd=tmp_path)
    assert told["problem"] == ""
    ticked = [item for item in told["items"] if item[3] >= told["ticked"]]
    assert {reason for _, _, reason, _, _ in ticked} == {"place"}
    assert len({place for *_, place in ticked}) == 1
    assert 1 <= len(ticked) <= 10
    # They are kept for the next time. A page that was told not to look has none.
    file = tmp_path / "runs" / "det.labels.suggestions.json"
    kept = json.loads(file.read_text())
    file.write_text(json.dumps({"key": kept["key"], "rows": kept["rows"][:1]}))
    assert len(suggested(*arguments, cwd=tmp_path)["items"]) == 1
    told = suggested(*arguments, "--no-suggest", cwd=tmp_path)
    assert (told["ready"], told["items"]) == (True, [])
