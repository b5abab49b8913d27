"""Live cameras that fail: ``python -m experiments.recovery [servers|latency|kills] [--quick]``.

``servers``: `phdtrack live` on an RTSP, an MJPEG and an HLS server on this machine, which is killed
and restarted, freezes, accepts without answering, slows down, and changes its size. A square moves
to and fro by the clock, so that times, speeds and identities in the rows can be checked.
``latency``: from the arrival of a frame to its events on disk. ``kills``: `phdtrack live` itself is
killed at random times and restarted. Figures go to runs/reliability, as JSON.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "live"))
from camera_server import CameraServer, HlsServer, RtspServer, square, until, walker  # noqa: E402

OUT = ROOT / "runs" / "reliability"
# Speed of the square in pixels per second, in images of 640 × 480.
SPEED = (640 - 80) / 8
LIVE = [sys.executable, "-m", "phdtrack", "live", "--set", "detector.min_area=0.005", "--json"]


class Mjpeg:
    """`CameraServer` with the square."""

    def __init__(self) -> None:
        self._server = CameraServer()
        self._server.rate = 25.0
        self._server.size = (640, 480)
        self.url = self._server.url
        self._server.draw = lambda wall: square(wall, *self._server.size)
        self.port = self._server.port
        self.kill = self._server.kill
        self.restart = self._server.restart

    def end(self) -> None: ...

    def say(self, command: str) -> None:
        obey(self._server, command)


class Rtsp(RtspServer):
    def end(self) -> None: ...


class Hls(HlsServer):
    def __init__(self) -> None:
        super().__init__(Path(tempfile.mkdtemp()))
        time.sleep(4)

    def say(self, command: str) -> None:
        obey(self, command)


def obey(server: Any, command: str) -> None:
    """Carry out a command as `rtsp_server.py` does."""
    word, *numbers = command.split()
    if word == "rate":
        server.rate = float(numbers[0])
    elif word == "size":
        server.size = (int(numbers[0]), int(numbers[1]))
    else:
        server.frozen = word == "freeze"


SERVERS: dict[str, Callable[[], Any]] = {"mjpeg": Mjpeg, "rtsp": Rtsp, "hls": Hls}


class Rows:
    """The rows of detected tracks in the files of `phdtrack live`, read as they grow."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read = Counter[str]()
        self.rows = list[tuple[float, int, float]]()

    def newest(self) -> float:
        """Read new rows; return the time of the newest one, 0 if there is none."""
        for path in sorted(self._folder.glob("tracks/*.csv*")):
            stem = path.name.removesuffix(".part")
            with path.open() as file:
                file.seek(self._read[stem])
                text = file.read()
            text = text[: text.rfind("\n") + 1]
            self._read[stem] += len(text.encode())
            for row in csv.reader(text.splitlines()):
                # Confirmed rows that use a detection.
                if row[0] != "time" and row[10] == "1" and row[9] != "-1":
                    middle = float(row[4]) + float(row[6]) / 2
                    self.rows.append(
                        (datetime.fromisoformat(row[0]).timestamp(), int(row[2]), middle)
                    )
        return self.rows[-1][0] if self.rows else 0.0

    def between(self, start: float, end: float) -> np.ndarray:
        """(N, 3) time, identity and centre of the rows between these times."""
        self.newest()
        return np.array([row for row in self.rows if start <= row[0] < end]).reshape(-1, 3)


@contextmanager
def running(
    words: Sequence[str], stdout: Any = subprocess.DEVNULL
) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([*LIVE, *words], stdout=stdout, stderr=subprocess.DEVNULL) as child:
        try:
            yield child
        finally:
            if child.poll() is None:
                child.kill()


def resident(pid: int) -> float:
    """Resident memory of a process in megabytes."""
    (line,) = (
        line
        for line in Path(f"/proc/{pid}/status").read_text().splitlines()
        if line.startswith("VmRSS")
    )
    return int(line.split()[1]) / 1000


def steady(seconds: float) -> None:
    """Wait until the square will not turn for the next ``seconds``."""
    until(lambda: 0.5 < time.time() % 8 < 7.5 - seconds)


@contextmanager
def mute(server: Any) -> Iterator[None]:
    """Replace the server by one at the same port that accepts connections and never answers."""
    server.kill()
    listening = socket.create_server(("127.0.0.1", server.port))
    held = list[socket.socket]()

    def accept() -> None:
        with suppress(OSError):
            while True:
                held.append(listening.accept()[0])

    threading.Thread(target=accept, daemon=True).start()
    yield
    with suppress(OSError):
        listening.shutdown(socket.SHUT_RDWR)
    listening.close()
    for one in held:
        one.close()
    server.restart()


def trial(server: Any, failure: str, seconds: float) -> None:
    """Cause one failure for ``seconds``."""
    if failure == "killed":
        server.kill()
        time.sleep(seconds)
        server.restart()
    elif failure == "mute":
        with mute(server):
            time.sleep(seconds)
    else:
        there = {"frozen": "freeze", "slow": "rate 1", "size": "size 320 240"}[failure]
        server.say(there)
        time.sleep(seconds)
        server.say({"frozen": "thaw", "slow": "rate 25", "size": "size 640 480"}[failure])


def plan(quick: bool) -> list[tuple[str, float]]:
    """The failures of each server with their seconds."""
    short = (
        [("killed", 0.8)] * 20
        + [("frozen", 1.5)] * 5
        + [("mute", 1.0)] * 5
        + [("size", 2.0)] * 4
        + [("slow", 5.0)] * 2
    )
    return (
        [("killed", 0.5), ("size", 1.0)]
        if quick
        else [*short, ("killed", 12.0), ("frozen", 12.0), ("mute", 15.0)]
    )


def measured(
    rows: Rows, failure: str, seconds: float, begun: float, back: float
) -> dict[str, object]:
    """Recovery, identity and speed in the rows after a failure from ``begun`` to ``back`` (seconds
    since 1970).
    """
    before = rows.between(begun - 1, begun)
    after = rows.between(back, back + 60)
    found: dict[str, object] = {"what": failure, "seconds": seconds, "gap": round(back - begun, 2)}
    found["recovered"] = round(float(after[0, 0]) - back, 3)
    found["kept"] = bool(len(before) and after[0, 1] == before[-1, 1])
    # The first half second may have frames that were sent before.
    still = after[(after[:, 0] > after[0, 0] + 0.5) & (after[:, 0] // 8 == after[0, 0] // 8)]
    if len(still) > 10 and np.ptp(still[:, 0]) > 1:
        found["speed"] = round(
            abs(float(np.polyfit(still[:, 0] - still[0, 0], still[:, 2], 1)[0])) / SPEED, 4
        )
    if failure == "slow":
        during = np.diff(np.unique(rows.between(begun + 1.5, back)[:, 0]))
        found["interval"] = round(float(np.median(during)), 3) if len(during) else None
    return found


def on_server(name: str, quick: bool) -> dict[str, object]:
    """Cause all failures of a server, one after the other, during one `phdtrack live`."""
    server = SERVERS[name]()
    out = Path(tempfile.mkdtemp())
    rows = Rows(out / "cam")
    found = list[dict[str, object]]()
    memory = list[float]()
    with running([f"cam={server.url}", "--out", str(out), "--no-page"]) as child:
        until(lambda: rows.newest())
        time.sleep(5)
        for k, (failure, seconds) in enumerate(plan(quick)):
            steady(min(seconds + 2.5, 6.5))
            begun = time.time()
            trial(server, failure, seconds)
            back = time.time()
            until(lambda back=back: rows.newest() >= back, 90.0)
            time.sleep(2.5 + 0.5 * random.random())
            found.append(measured(rows, failure, seconds, begun, back))
            memory.append(round(resident(child.pid), 1))
            print(name, k, found[-1], memory[-1], f"load {os.getloadavg()[0]:.1f}", flush=True)
        signalled = time.monotonic()
        child.send_signal(signal.SIGTERM)
        status = child.wait(60)
        ended = time.monotonic() - signalled
    server.kill()
    server.end()
    times = {
        failure: [one["recovered"] for one in found if one["what"] == failure]
        for failure in dict(plan(quick))
    }
    speeds = [one["speed"] for one in found if "speed" in one]
    return {
        "recovered_median_worst": {
            failure: (float(np.median(each)), max(each)) for failure, each in times.items()
        },
        "kept_short_gaps": [
            sum(bool(one["kept"]) for one in found if one["gap"] < 3),
            sum(one["gap"] < 3 for one in found),
        ],
        "speed_to_truth_least_most": (min(speeds), max(speeds)),
        "resident_mb": memory,
        "exit_status_and_seconds": (status, round(ended, 2)),
        "trials": found,
    }


def latency(quick: bool) -> dict[str, object]:
    """Median and 99 % quantile of the latency in milliseconds, with one camera and with four."""
    found = dict[str, object]()
    for cameras in (1, 4):
        servers = [Mjpeg() for _ in range(cameras)]
        out = Path(tempfile.mkdtemp())
        with socket.create_server(("127.0.0.1", 0)) as one:
            port = one.getsockname()[1]
        words = [f"cam{k}={server.url}" for k, server in enumerate(servers)]
        with running([*words, "--out", str(out), "--port", str(port)]) as child:
            rows = [Rows(out / f"cam{k}") for k in range(cameras)]
            until(lambda rows=rows: all(one.newest() for one in rows))
            time.sleep(5 if quick else 90)

            def status_of(k: int, port: int = port) -> dict[str, Any]:
                with urllib.request.urlopen(
                    f"http://127.0.0.1:{port}/api/camera/cam{k}", timeout=60
                ) as answer:
                    status: dict[str, Any] = json.load(answer)
                    return status

            answers = [status_of(k) for k in range(cameras)]
            child.send_signal(signal.SIGTERM)
            child.wait(60)
        for server in servers:
            server.kill()
        found[f"{cameras} × 640×480, 25 a second, change detector, video 5 a second"] = {
            "median_ms": [round(1000 * one["latency"][0], 1) for one in answers],
            "p99_ms": [round(1000 * one["latency"][1], 1) for one in answers],
            "frames_dropped": [(one["frames"], one["dropped"]) for one in answers],
            "load": os.getloadavg()[0],
        }
        print(found, flush=True)
    return found


class Hook(BaseHTTPRequestHandler):
    """Receives events; `taken` of its server has the identifier and content of each confirmed
    one.
    """

    def do_POST(self) -> None:
        event = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(200)
        self.end_headers()
        self.server.taken.append((self.headers["Idempotency-Key"], event))  # type: ignore[attr-defined]

    def log_message(self, *_: object) -> None: ...


def kills(quick: bool) -> dict[str, object]:
    """Kill `phdtrack live` repeatedly on one folder, and check everything that it wrote and
    sent.
    """
    camera = CameraServer()
    hook = ThreadingHTTPServer(("127.0.0.1", 0), Hook)
    camera.draw = walker
    hook.taken = []  # type: ignore[attr-defined]
    threading.Thread(target=hook.serve_forever, daemon=True).start()
    out = Path(tempfile.mkdtemp())
    generator = random.Random(20)
    events = list[dict[str, Any]]()
    folder = out / "cam"
    found = Counter[str]()
    (out / "places.toml").write_text(
        '[[line]]\nname = "door"\npoints = [[80, 119], [80, 0]]\n\n'
        '[[zone]]\nname = "room"\npoints = [[0, 0], [60, 0], [60, 119], [0, 119]]\n'
    )
    words = [
        f"cam={camera.url}",
        "--out",
        str(out),
        "--no-page",
        "--places",
        str(out / "places.toml"),
        "--leave-after",
        "1",
    ]
    words += ["--webhook", f"http://127.0.0.1:{hook.server_port}/", "--allow-private"]
    names = ["SIGKILL", "SIGTERM"] if quick else ["SIGKILL"] * 50 + ["SIGTERM"] * 15
    generator.shuffle(names)
    for k, name in enumerate([*names, "SIGTERM"]):
        more = ["--parquet"] if k % 5 == 4 else []
        had = len(events)
        with (out / "said").open("w+b") as stdout, running([*words, *more], stdout) as child:
            if k % 4 or k == len(names):
                until(lambda stdout=stdout: b'"identity"' in Path(stdout.name).read_bytes())
            time.sleep(generator.uniform(0, 5.0) + 6.0 * (k == len(names)))
            child.send_signal(getattr(signal, name))
            begun = time.monotonic()
            status = child.wait(60)
            found[f"{name} {status}"] += 1
            if name == "SIGTERM":
                found["slowest SIGTERM, ms"] = max(
                    found["slowest SIGTERM, ms"], round(1000 * (time.monotonic() - begun))
                )
                found["left .part after SIGTERM with status 0"] += (
                    len(list(out.rglob("*.part"))) if status == 0 else 0
                )
            text = (out / "said").read_bytes()
        events += [json.loads(line) for line in text[: text.rfind(b"\n") + 1].splitlines()]
        if folder.exists():
            look(folder, found)
        print(k, name, len(events) - had, dict(found), flush=True)
    camera.kill()
    hook.shutdown()
    return {
        "folder": str(out),
        "runs": len(names) + 1,
        **checked(folder, events, hook.taken),
        **found,
    }  # type: ignore[attr-defined]


def look(folder: Path, found: Counter[str]) -> None:
    """Count unreadable files among those with their final name."""
    from pyarrow import parquet

    from phdtrack.video import open_source

    for path in sorted(folder.rglob("*.*")):
        if path.suffix == ".csv":
            text = path.read_text()
            found["cut rows"] += not text.endswith("\n") or any(
                line.count(",") != 10 for line in text.splitlines()
            )
        elif path.suffix == ".parquet":
            found["unreadable parquet"] += parquet.read_table(path).num_rows < 1
        elif path.suffix == ".mp4":
            try:
                source = open_source(path)
                found["videos with a problem"] += not list(source) or bool(source.problem)
            except Exception:
                found["unreadable videos"] += 1
    lines = (
        (folder / "events.jsonl").read_text().split("\n")
        if (folder / "events.jsonl").exists()
        else [""]
    )
    found["events.jsonl ended in a cut line before the next start"] += bool(lines[-1])
    for line in lines[:-1]:
        json.loads(line)


def checked(
    folder: Path, events: list[dict[str, Any]], deliveries: list[tuple[str, dict[str, Any]]]
) -> dict[str, object]:
    """Whether files, table, lines on stdout and the webhook agree."""
    import sqlite3

    kept = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    base = sqlite3.connect(folder / "events.sqlite")
    table = [
        json.loads(text) for (text,) in base.execute("SELECT event FROM events ORDER BY rowid")
    ]
    base.close()
    camera_events = [event for event in events if event["kind"] != "source"]
    names = {event["id"] for event in kept}
    received = Counter(name for name, _ in deliveries)

    def content(event: dict[str, Any]) -> str:
        return json.dumps(
            {key: value for key, value in event.items() if key != "id"}, sort_keys=True
        )

    twice = Counter(content(event) for event in kept)
    return {
        "events": len(kept),
        "kinds": Counter(event["kind"] for event in kept),
        "file and table differ": kept != table,
        "identifiers twice in the file": len(kept) - len(names),
        "one event under two identifiers": sum(number > 1 for number in twice.values()),
        "said on stdout and lost": sum(event["id"] not in names for event in camera_events),
        "said on stdout": len(camera_events),
        "delivered and not in the file": sum(name not in names for name in received),
        "in the file and never delivered": sum(name not in received for name in names),
        "delivered more than once, under the same identifier": sum(
            number > 1 for number in received.values()
        ),
        "order of deliveries differs": list(dict.fromkeys(name for name, _ in deliveries))
        != [event["id"] for event in kept],
        "in order": [event["time"] for event in kept] == sorted(event["time"] for event in kept),
    }


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", nargs="*", default=["servers", "latency", "kills"])
    parser.add_argument(
        "--quick", action="store_true", help="a short form that shows that everything works"
    )
    parser.add_argument(
        "--server", action="append", choices=tuple(SERVERS), help="only this one; repeatable"
    )
    parsed = parser.parse_args(words)
    OUT.mkdir(parents=True, exist_ok=True)
    for part in parsed.part:
        if part == "servers":
            for name in parsed.server or SERVERS:
                write("recovery", {name: on_server(name, parsed.quick)})
        elif part == "latency":
            write("recovery", {"latency": latency(parsed.quick)})
        else:
            write("kills-live", kills(parsed.quick))


def write(name: str, found: dict[str, object]) -> None:
    """Add figures to a file."""
    path = OUT / f"{name}.json"
    before = json.loads(path.read_text()) if path.exists() else {}
    path.write_text(json.dumps(before | found, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
