"""Files by the hour, videos whose time is true, events that are kept once, and their delivery; each
after a kill, too.
"""

from __future__ import annotations

import json
import os
import socket
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.live import delivery
from phdtrack.live.delivery import Courier, Mqtt, Webhook, receivers
from phdtrack.live.outputs import HEAD, EventLog, RowsLog, Segments, VideoLog, stamp
from phdtrack.types import Tracks
from phdtrack.video import open_source

# 2026-11-24, 05:59:58 UTC.
WALL = 1795499998.0


def rows(number: int, count: int = 2) -> Tracks:
    boxes = np.array([[10.0 * k, 5, 10 * k + 8, 25] for k in range(count)])
    return Tracks.of(number, np.arange(1, count + 1), boxes, 0.5, 0)


def names(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def test_rows_are_in_the_file_of_their_hour(tmp_path: Path) -> None:
    log = RowsLog(tmp_path)
    for k in range(4):
        log.write(rows(k + 1), WALL + k)
        assert names(tmp_path)[-1].endswith(".part")
    # Also where nobody is seen, an hour that is over gets its name.
    log.write(Tracks.empty(), WALL + 3602)
    assert names(tmp_path)[-1] == "2026-11-24T06.csv"
    assert log.last_frame() == 4
    log.finish()
    assert names(tmp_path) == ["2026-11-24T05.csv", "2026-11-24T06.csv"]
    first, second = (file.read_text().splitlines() for file in sorted(tmp_path.iterdir()))
    assert first[0] + "\n" == second[0] + "\n" == HEAD
    assert (len(first), len(second)) == (5, 5)
    assert first[1] == "2026-11-24T05:59:58.000Z,1,1,0,0,5,8,20,0.5,0,1"


def test_an_hour_whose_file_could_not_be_opened_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(24, "Too many open files")

    log = RowsLog(tmp_path)
    with monkeypatch.context() as broken:
        broken.setattr(Path, "open", full)
        with pytest.raises(OSError, match="Too many"):
            log.write(rows(1), WALL)
    log.write(rows(2), WALL + 1)
    log.finish()
    (file,) = tmp_path.iterdir()
    assert len(file.read_text().splitlines()) == 3


def test_what_a_killed_run_left_is_kept_up_to_its_last_line(tmp_path: Path) -> None:
    log = RowsLog(tmp_path)
    log.write(rows(1), WALL)
    part = tmp_path / "2026-11-24T05.csv.part"
    with part.open("a") as file:
        file.write("2026-11-24T05:59:59.000Z,2,1,0,0.1")
    log.close()
    again = RowsLog(tmp_path)
    assert names(tmp_path) == ["2026-11-24T05.csv"]
    assert len((tmp_path / "2026-11-24T05.csv").read_text().splitlines()) == 3
    again.write(rows(2), WALL + 1)
    again.finish()
    assert names(tmp_path) == ["2026-11-24T05.2.csv", "2026-11-24T05.csv"]


def test_the_oldest_files_go_when_the_quota_is_full(tmp_path: Path) -> None:
    segments = Segments(tmp_path, ".bin", 60, quota=2500)
    for k in range(5):
        assert segments.over(WALL + 60 * k)
        segments.begin(WALL + 60 * k).write_bytes(b"x" * 1000)
        assert not segments.over(WALL + 60 * k)
        segments.finish()
    assert names(tmp_path) == ["2026-11-24T06-02-00.bin", "2026-11-24T06-03-00.bin"]


def test_of_one_stretch_the_first_files_go_first(tmp_path: Path) -> None:
    for name in ("T05.bin", *(f"T05.{k}.bin" for k in range(2, 12)), "T06.bin", "T07.bin.part"):
        (tmp_path / f"2026-11-24{name}").write_bytes(b"x" * 1000)
    Segments(tmp_path, ".bin", 3600, quota=3000).prune()
    assert names(tmp_path) == [
        f"2026-11-24{name}" for name in ("T05.10.bin", "T05.11.bin", "T06.bin", "T07.bin.part")
    ]


def test_an_hour_becomes_parquet(tmp_path: Path) -> None:
    from pyarrow import parquet

    log = RowsLog(tmp_path, parquet=True)
    log.write(rows(1), WALL)
    log.finish()
    assert names(tmp_path) == ["2026-11-24T05.parquet"]
    table = parquet.read_table(tmp_path / "2026-11-24T05.parquet")
    assert table.column_names == HEAD.strip().split(",")
    assert table["identity"].to_pylist() == [1, 2]
    assert log.last_frame() == 1


def test_an_hour_killed_during_conversion_is_kept_once(tmp_path: Path) -> None:
    """Before its name, and after it."""
    for name in ("T05.csv", "T05.parquet.part", "T06.csv", "T06.parquet", "T07.parquet"):
        (tmp_path / f"2026-11-24{name}").write_text("x")
    RowsLog(tmp_path, parquet=True)
    assert names(tmp_path) == [
        f"2026-11-24{name}" for name in ("T05.csv", "T06.parquet", "T07.parquet")
    ]


def test_time_in_a_video_is_true_however_pictures_come(tmp_path: Path) -> None:
    """Pictures at uneven times, at 10 a second: each is shown from its time to the next one's."""
    log = VideoLog(tmp_path, 10.0)
    for k, at in enumerate([2.0, 2.1, 2.25, 3.0, 3.02, 4.0]):
        log.write(np.full((48, 64, 3), 40 * k, np.uint8), WALL + at)
    log.finish()
    assert names(tmp_path) == ["2026-11-24T06-00-00.mp4"]
    shades = [
        round(float(frame.image.mean()) / 40)
        for frame in open_source(tmp_path / "2026-11-24T06-00-00.mp4")
    ]
    assert len(shades) == 21
    assert [shades[0], shades[1], shades[5], shades[10], shades[20]] == [0, 1, 3, 3, 5]


def test_a_gap_begins_a_new_video(tmp_path: Path) -> None:
    log = VideoLog(tmp_path, 5.0)
    for at in [2.0, 2.2, 2.4, 30.0, 30.2]:
        log.write(np.zeros((48, 64, 3), np.uint8), WALL + at)
    log.finish()
    assert names(tmp_path) == ["2026-11-24T06-00-00.2.mp4", "2026-11-24T06-00-00.mp4"]


def test_the_video_of_a_killed_run_loses_its_last_seconds_only(tmp_path: Path) -> None:
    pictures = np.random.default_rng(1).integers(0, 255, (10, 48, 64, 3), np.uint8)
    log = VideoLog(tmp_path, 5.0)
    for k in range(100):
        log.write(pictures[k % 10], WALL + 2 + k / 5)
    # Killed: what is on disk is as it is, here within a fragment.
    part = tmp_path / "2026-11-24T06-00-00.mp4.part"
    (tmp_path / "2026-11-24T06-10-00.mp4.part").write_bytes(part.read_bytes()[:1000])
    (tmp_path / "2026-11-24T06-20-00.mp4.part").write_bytes(part.read_bytes()[:-1000])
    VideoLog(tmp_path, 5.0)
    assert names(tmp_path) == ["2026-11-24T06-00-00.mp4", "2026-11-24T06-20-00.mp4"]
    for path in tmp_path.iterdir():
        source = open_source(path)
        assert len(list(source)) >= 70
        assert source.problem == ""
    log.finish()


def event(number: int) -> dict[str, object]:
    return {"id": f"gate-{number}-0", "time": stamp(WALL), "kind": "appear", "identity": number}


def test_an_event_is_kept_once(tmp_path: Path) -> None:
    log = EventLog(tmp_path)
    assert [e["identity"] for e in log.write([event(1), event(2)])] == [1, 2]
    assert [e["identity"] for e in log.write([event(2), event(3)])] == [3]
    assert (log.highest(), log.highest("appear"), log.highest("group")) == (3, 3, 0)
    lines = (tmp_path / "events.jsonl").read_text().splitlines()
    assert [json.loads(line)["identity"] for line in lines] == [1, 2, 3]
    log.close()


def test_each_receiver_has_what_comes_after_it_was_named(tmp_path: Path) -> None:
    log = EventLog(tmp_path)
    log.register("one")
    log.write([event(1), event(2)])
    log.register("two")
    log.write([event(3)])
    log.delivered("one", log.waiting("one")[0][0])
    log.close()
    log = EventLog(tmp_path)
    for name in ("one", "two"):
        log.register(name)
    assert [name for _, name, _ in log.waiting("one")] == ["gate-2-0", "gate-3-0"]
    assert [name for _, name, _ in log.waiting("two")] == ["gate-3-0"]
    log.delivered("two", log.waiting("two")[0][0])
    assert (len(log.waiting("one")), log.waiting("two")) == (2, [])
    log.close()


def test_lines_that_a_kill_kept_from_the_file_are_written_later(tmp_path: Path) -> None:
    log = EventLog(tmp_path)
    log.write([event(1), event(2), event(3)])
    log.close()
    whole = (tmp_path / "events.jsonl").read_bytes()
    os.truncate(tmp_path / "events.jsonl", len(whole) - 20)
    EventLog(tmp_path).close()
    assert (tmp_path / "events.jsonl").read_bytes() == whole


def test_unwritten_lines_are_written_with_the_next_event(tmp_path: Path) -> None:
    log = EventLog(tmp_path)
    lines = tmp_path / "events.jsonl"
    log.write([event(1)])
    # The disk was full in the middle of a line.
    first = lines.read_bytes()
    lines.unlink()
    lines.mkdir()
    assert log.write([event(2)]) == [event(2)]
    assert log.problem.startswith("events.jsonl is still to be brought up to date")
    lines.rmdir()
    lines.write_bytes(first + b'{"id": "gate-2')
    assert log.write([event(3)]) == [event(3)]
    assert log.problem == ""
    assert [json.loads(line) for line in lines.read_text().splitlines()] == [
        event(1),
        event(2),
        event(3),
    ]
    log.close()


def test_moved_lines_and_deleted_rows_are_tolerated(tmp_path: Path) -> None:
    log = EventLog(tmp_path)
    lines = tmp_path / "events.jsonl"
    log.register("one")
    log.write([event(1), event(2)])
    lines.rename(tmp_path / "old.jsonl")
    log.write([event(3)])
    log.delivered("one", log.waiting("one")[-1][0])
    log.close()
    base = sqlite3.connect(tmp_path / "events.sqlite")
    with base:
        base.execute("DELETE FROM events")
    base.close()
    log = EventLog(tmp_path)
    log.write([event(4)])
    assert [name for _, name, _ in log.waiting("one")] == ["gate-4-0"]
    assert [json.loads(line) for line in lines.read_text().splitlines()] == [event(3), event(4)]
    log.close()


def test_visitors_are_saved_with_their_events_or_not_at_all(tmp_path: Path) -> None:
    log = EventLog(tmp_path)
    assert log.watched() is None
    log.write([event(1)], (7, b"seven"))
    with pytest.raises(TypeError):
        log.write([event(2), {"id": object()}], (8, b"eight"))
    assert log.watched() == (7, b"seven")
    assert log.highest() == 1
    log.forget_watched()
    assert log.watched() is None
    log.close()


def test_a_receiver_is_the_same_with_another_password_or_token() -> None:
    first, second = receivers(["https://a:b@hooks.example/x?token=1", "mqtt://u:p@hooks.example/x"])
    assert receivers(["https://a:c@hooks.example/x?token=2"]) == [first]
    assert (
        len(
            {
                first,
                second,
                *receivers(["https://hooks.example/y"]),
                *receivers(["https://other.example/x"]),
            }
        )
        == 4
    )
    assert receivers(["https://hooks.example:443/x"]) == [first]
    alike = receivers(["https://hooks.example/x?to=1", "https://hooks.example/x?to=2"])
    assert alike[0] == first
    assert alike[1] not in (first, second)


class Client:
    """Stands for that of paho: it says when the broker confirms."""

    on_publish: Any = None

    def __init__(self) -> None:
        self.sent = list[tuple[str, str]]()
        self.confirms = True

    def is_connected(self) -> bool:
        return True

    def publish(self, topic: str, event: str, qos: int) -> SimpleNamespace:
        self.sent.append((topic, event))
        if self.confirms:
            self.on_publish(self, None, len(self.sent), 0, None)
        # What there is no connection for is sent later.
        return SimpleNamespace(rc=4, mid=len(self.sent))


def test_an_unconfirmed_event_is_published_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(delivery, "TIMEOUT", 0.01)
    client = Client()
    mqtt = Mqtt("mqtt://broker.example/site", lambda: client)
    client.confirms = False
    for _ in range(3):
        with pytest.raises(OSError, match="the broker did not confirm"):
            mqtt("a", '{"kind": "appear"}')
    client.on_publish(client, None, 1, 0, None)
    mqtt("a", '{"kind": "appear"}')
    client.confirms = True
    mqtt("b", '{"kind": "leave"}')
    assert client.sent == [
        ("site/appear", '{"kind": "appear"}'),
        ("site/leave", '{"kind": "leave"}'),
    ]
    with pytest.raises(InputError, match="a topic without the wildcards"):
        Mqtt("mqtt://broker.example/site/+", Client)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A courier tries again soon."""
    monkeypatch.setattr(delivery, "FIRST_PAUSE", 0.01)


@pytest.mark.usefixtures("quick")
def test_an_event_is_sent_once_if_that_cannot_be_recorded(tmp_path: Path) -> None:
    log = EventLog(tmp_path)
    taken = list[str]()
    tried = list[int]()
    delivered = log.delivered

    def busy(receiver: str, row: int) -> None:
        tried.append(row)
        if len(tried) < 2:
            raise sqlite3.OperationalError("database is locked")
        delivered(receiver, row)

    log.delivered = busy  # type: ignore[method-assign]
    courier = Courier(log, lambda name, event: taken.append(name), "one")
    log.write([event(1)])
    courier.wake()
    until(lambda: len(tried) == 2)
    courier.stop()
    assert taken == ["gate-1-0"]
    log.close()


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "events.sqlite").mkdir()
    with pytest.raises(InputError, match="the events cannot be written"):
        EventLog(tmp_path)


class Receiver(BaseHTTPRequestHandler):
    """Takes events, or answers with the status that its server says."""

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        status = self.server.status
        self.server.headers = self.headers  # type: ignore[attr-defined]
        if status == 200:
            self.server.taken.append((self.headers["Idempotency-Key"], json.loads(body)))  # type: ignore[attr-defined]
        self.send_response(status)
        self.send_header("Location", "/elsewhere")
        self.end_headers()

    def log_message(self, *_: object) -> None: ...


@pytest.fixture
def receiver() -> Iterator[ThreadingHTTPServer]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Receiver)
    server.status = 200
    server.taken = []  # type: ignore[attr-defined]
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def until(ready: object, patience: float = 600.0) -> None:
    end = time.monotonic() + patience
    while not ready():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.usefixtures("quick")
def test_webhook_events_keep_their_order_after_failures(
    tmp_path: Path, receiver: ThreadingHTTPServer
) -> None:
    log = EventLog(tmp_path)
    receiver.status = 503  # type: ignore[attr-defined]
    courier = Courier(
        log, Webhook(f"http://127.0.0.1:{receiver.server_port}/hook?x=1", private=True), "webhook"
    )
    log.write([event(1), event(2)])
    courier.wake()
    until(lambda: courier.problem == "the answer was 503")
    receiver.status = 200  # type: ignore[attr-defined]
    until(lambda: len(receiver.taken) == 2)  # type: ignore[attr-defined]
    log.write([event(3)])
    courier.wake()
    until(lambda: len(receiver.taken) == 3)  # type: ignore[attr-defined]
    assert [key for key, _ in receiver.taken] == ["gate-1-0", "gate-2-0", "gate-3-0"]  # type: ignore[attr-defined]
    courier.stop()
    log.close()


@pytest.mark.usefixtures("quick")
def test_whatever_a_receiver_raises_is_said_and_tried_again(tmp_path: Path) -> None:
    log = EventLog(tmp_path)
    taken = list[str]()
    problems = list[str]()

    def send(name: str, event: str) -> None:
        taken.append(name)
        problems.append(courier.problem)
        if len(taken) == 1:
            raise ValueError("topics have no wildcards")

    courier = Courier(log, send, "mqtt")
    log.write([event(1)])
    courier.wake()
    until(lambda: len(taken) == 2)
    courier.stop()
    assert taken == ["gate-1-0", "gate-1-0"]
    assert problems == ["", "topics have no wildcards"]
    assert courier.problem == ""
    log.close()


PRIVATE = [
    "127.0.0.1", "localhost", "10.0.0.1", "172.16.0.1", "192.168.0.1", "169.254.169.254",
    "100.64.0.1", "0.0.0.0",
    "224.0.0.1",
    "255.255.255.255", "192.0.2.1", "240.0.0.1",
    # The same in other forms.
    "2130706433", "0x7f000001", "0177.0.0.1", "127.1", "0x7f.1", "127.000.000.001",
    "%31%32%37.0.0.1",
    "[::1]", "[::]", "[fe80::1]", "[fd00::1]", "[fec0::1]", "[ff02::1]", "[::ffff:127.0.0.1]",
    "[::ffff:a00:1]",
    "[::127.0.0.1]",
    "[2002:7f00:1::1]", "[64:ff9b::7f00:1]", "[64:ff9b::a00:1]", "[64:ff9b:1::1]",
    "[2001:db8::1]", "[100::1]",
]  # fmt: skip


@pytest.mark.parametrize("host", PRIVATE)
def test_private_networks_are_refused(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "create_connection", lambda *_: pytest.fail("it was connected to"))
    with pytest.raises(OSError) as found:
        Webhook(f"http://{host}:9/")("a", "{}")
    # A system without a way to an address, or without a name, says so itself.
    assert isinstance(found.value, PermissionError | socket.gaierror)


@pytest.mark.parametrize("ip", ["8.8.8.8", "2606:4700::1", "64:ff9b::808:808", "::ffff:8.8.8.8"])
def test_public_addresses_are_looked_up_once_and_used(ip: str, monkeypatch) -> None:
    """A name is looked up once: what it leads to later (DNS rebinding) does not matter."""
    asked = list[object]()
    answers = iter([ip, "127.0.0.1", "127.0.0.1"])

    def looked_up(host: str, port: int, **_: object) -> list[object]:
        return [(0, 0, 0, "", (next(answers), port))]

    def connected(address: object, timeout: float) -> None:
        asked.append(address)
        raise ConnectionRefusedError

    monkeypatch.setattr(socket, "getaddrinfo", looked_up)
    monkeypatch.setattr(socket, "create_connection", connected)
    hook = Webhook("http://hook.example/x")
    with pytest.raises(ConnectionRefusedError):
        hook("a", "{}")
    assert asked == [(ip, 80)]
    # The next time the name leads home: that is seen before a connection is made.
    with pytest.raises(PermissionError, match="is in a private network"):
        hook("a", "{}")
    assert len(asked) == 1


def test_one_private_address_among_others_is_enough_to_refuse(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = [(0, 0, 0, "", ("8.8.8.8", 80)), (0, 0, 0, "", ("10.0.0.1", 80))]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    with pytest.raises(PermissionError):
        Webhook("http://hook.example/")("a", "{}")


def test_no_redirection_is_followed_and_the_password_is_a_header(
    receiver: ThreadingHTTPServer,
) -> None:
    receiver.status = 302  # type: ignore[attr-defined]
    hook = Webhook(f"http://bob:a%40b@127.0.0.1:{receiver.server_port}/hook", private=True)
    with pytest.raises(OSError, match="the answer was 302"):
        hook("a", "{}")
    receiver.status = 200  # type: ignore[attr-defined]
    hook("b", "{}")
    assert [key for key, _ in receiver.taken] == ["b"]  # type: ignore[attr-defined]
    assert receiver.headers["Authorization"] == "Basic Ym9iOmFAYg=="  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("scheme", "begins"), [("http", b"HTTP/1.1 200 OK\r\nX: "), ("https", b"\x16\x03\x03\x40\x00")]
)
def test_a_receiver_whose_answer_does_not_end_is_cut(
    scheme: str, begins: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each byte comes in time: of the header, or of the greeting of TLS."""
    monkeypatch.setattr(delivery, "WHOLE", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def drip() -> None:
            with server.accept()[0] as connection, suppress(OSError):
                connection.sendall(begins)
                while True:
                    connection.sendall(b"a")
                    time.sleep(0.02)

        dripping = threading.Thread(target=drip)
        dripping.start()
        with pytest.raises(TimeoutError, match=r"it took more than 0.5 s"):
            Webhook(f"{scheme}://127.0.0.1:{server.getsockname()[1]}/", private=True)("a", "{}")
        dripping.join()


def test_addresses_that_are_none_are_refused() -> None:
    more = (
        "http://" + "a" * 300 + ".example:99999/",
        "http://a:0/",
        "http://a:x/",
        "http://a/\r\nX: y",
        "http://a b/",
        "http://ä.example/",
        "http://[::1/",
    )
    for url in ("ftp://example.com", "example.com", "http:///x", *more):
        with pytest.raises(InputError, match="--webhook: expected an address"):
            Webhook(url)


def test_the_table_of_events_can_be_asked(tmp_path: Path) -> None:
    log = EventLog(tmp_path)
    log.write([event(k) for k in range(5)])
    base = sqlite3.connect(tmp_path / "events.sqlite")
    assert base.execute("SELECT count(*) FROM events WHERE kind = 'appear'").fetchone() == (5,)
    base.close()
    log.close()


def test_files_of_rows_that_somebody_has_changed_are_passed_over(tmp_path: Path) -> None:
    log = RowsLog(tmp_path)
    log.write(rows(7), WALL)
    log.finish()
    (tmp_path / "2026-11-24T06.csv").write_text(HEAD)
    (tmp_path / "2026-11-24T07.parquet").write_bytes(b"PAR1 and no more")
    (tmp_path / "2026-11-24T08.csv").write_text("")
    assert log.last_frame() == 7
    assert (tmp_path / "2026-11-24T07.parquet").exists()


def test_a_receiver_that_cannot_be_written_down_is_said(tmp_path: Path) -> None:
    log = EventLog(tmp_path, patience=0.001)
    other = sqlite3.connect(tmp_path / "events.sqlite", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(
        InputError, match=r"events.sqlite: cannot be written into \(database is locked\)"
    ):
        log.register("one")
    other.close()
    log.close()
