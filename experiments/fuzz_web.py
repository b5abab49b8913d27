"""Malformed requests against both pages, as a stranger would send them: ``python -m
experiments.fuzz_web [--number N]``.

`phdtrack label` and `phdtrack live` are started on a simulated street, and asked by raw sockets.
Seeds are fixed. The figures go to runs/reliability/fuzz-web.json: how many requests were answered
how, and the server's memory. A server error, a connection that hangs, memory that grows or a page
that no longer answers is a failure (exit status 1).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import random
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import quote

OUT = Path("runs/reliability/fuzz-web.json")
# Seconds for an answer, beyond which a request hangs: what is not complete is cut after 40; until a
# client without an answer says that it is done; connections at once.
PATIENCE = 60.0
WAITING = 1.0
SHARE = 24
METHODS = [
    "GET",
    "HEAD",
    "POST",
    "PUT",
    "DELETE",
    "OPTIONS",
    "TRACE",
    "CONNECT",
    "PATCH",
    "get",
    "",
    "G\x00T",
    "A" * 300,
]
VERSIONS = ["HTTP/1.1"] * 60 + [
    "HTTP/1.0",
    "HTTP/0.9",
    "HTTP/2.0",
    "HTTP/1.10",
    "HTTP/x",
    "",
    "http/1.1",
]
PATHS = [
    "/", "/metrics", "/healthz", "/api/cameras", "/api/camera/gate", "/api/camera/gate/minutes", "/api/camera/gate/places",
    "/picture/gate.jpg", "/map/gate/people.jpg", "/map/gate/clutter.jpg", "/static/live.js", "/static/label.js",
    "/api/overview", "/api/frame/1", "/api/frame/1/marks", "/api/frame/1/undo", "/api/frame/1/redo", "/api/frame/1/done",
    "/api/frame/1/alike/0", "/api/suggestions", "/api/map/false", "/api/labels.csv", "/still/1.jpg", "/crop/1/0.jpg",
]  # fmt: skip
NUMBERS = [
    "0",
    "-1",
    "1.5",
    "9" * 5,
    "9" * 20,
    "9" * 400,
    "1e9",
    "NaN",
    "0x10",
    "١",
    "%31",
    "+1",
    " 1",
    "1/2",
]
BITS = [
    "%", "%2", "%zz", "%00", "%ff%fe", "%2e%2e", "..", "//", "/../../etc/passwd", "\\", "?", "#", ";", "\x00", "\x7f", "é",
    "😀", " ", "\t",
    "%u0041", "a" * 300, "a" * 3000, "?after=" + "9" * 30, "?after=x&after=%", "?token=%ff", "?" + "a=b&" * 500,
    "%0d%0aX: y", "{}", "<b>",
]  # fmt: skip
HEADERS = [
    "Content-Length: 0", "Content-Length: 5", "Content-Length: -5", "Content-Length: +5", "Content-Length: 5, 5",
    "Content-Length: 5, 6", "Content-Length: 99999999999", "Content-Length: " + "9" * 300, "Content-Length: x",
    "Transfer-Encoding: chunked", "Transfer-Encoding: identity", "Transfer-Encoding: chunked, chunked",
    "Transfer-Encoding: \x0bchunked", "Transfer-Encoding : chunked", "X-Phdtrack: 1", "X-Phdtrack: 1", "X-Phdtrack: 1",
    "Host: evil.example", "Host:", "Origin: null", "Origin: http://evil.example", "Cookie: phdtrack_=\xff; a",
    "Cookie: " + "a=b; " * 400,
    "Range: bytes=0-1", "Range: bytes=" + "0-1," * 1000, "Expect: 100-continue", "Upgrade: websocket", "Connection: Upgrade",
    "Connection: keep-alive", "X: " + "y" * 9000, "X: " + "y" * 40000, "X: a\r\n folded", "\x00: y", "no colon", ": empty",
    "Accept: \xff\xfe",
    "If-None-Match: *", "If-Modified-Since: x", "Content-Type: text/plain; charset=\xff", "Content-Encoding: gzip",
]  # fmt: skip
BODIES = [
    b"", b"{}", b"[]", b"null", b"{", b"\xff\xfe", b"\x00" * 100, b"[" * 50_000, b'{"marks":' * 3000, b'"' + b"a" * 50_000,
    b"1" + b"0" * 6000,
    b'{"marks": [{"frame": 1, "box": 0, "mark": "false"}], "key": "k"}',
    b'{"marks": [{"frame": 1e99, "box": NaN, "mark": "birth"}]}',
    b'{"marks": [{"frame": -1, "box": 99999999999999999999, "mark": "none"}]}', b'{"done": "perhaps"}',
    b'{"who": "\\ud800\\u0000"}',
    b'{"line": [{"points": [[0, 0], [1e308, -1e308]]}]}', b'{"zone": [{"points": [[0,0],[1,0],[0,1]], "anchor": 3}]}',
    b'{"line": {"a": 1}}',
    b'{"zone": [{"name": "\\ud800", "points": [[0,0],[1,0],[0,1]]}]}', b'{"line": [{"points": ' + b"[" * 20000 + b"}]}",
    b" " * 1_100_000,
]  # fmt: skip


def request(rng: random.Random, host: str) -> bytes:
    """A request with some mistakes, or bytes that are none."""
    kind = rng.random()
    if kind < 0.04:
        return rng.randbytes(rng.choice([1, 10, 100, 3000, 30_000]))
    path = rng.choice(PATHS)
    if rng.random() < 0.5:
        path = re.sub(r"\d+|gate", lambda found: rng.choice([*NUMBERS, found[0]]), path)
    for _ in range(rng.choice([0] * 6 + [1, 1, 2, 4])):
        at = rng.randrange(len(path) + 1)
        path = path[:at] + rng.choice(BITS) + path[at:]
    if rng.random() < 0.5:
        # All is well but what is asked for and sent.
        path = re.sub(r"[^!-~]", lambda found: quote(found[0]), path)
        body = rng.choice(BODIES)
        verb, more = rng.choice(
            [
                ("GET", ""),
                ("HEAD", ""),
                ("POST", f"X-Phdtrack: 1\r\nContent-Length: {len(body)}\r\n"),
            ]
        )
        return (
            f"{verb} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n".encode()
            + (body if more else b"")
        )
    method = rng.choice(METHODS + ["GET", "POST"] * 30)
    body = rng.choice(BODIES)
    headers = [f"Host: {host}"] * rng.choice([1] * 40 + [0, 2]) + rng.choices(
        HEADERS, k=rng.choice([0] * 5 + [1, 1, 1, 2, 3, 8])
    )
    if method == "POST" and rng.random() < 0.7:
        headers += ["X-Phdtrack: 1", f"Content-Length: {len(body)}"]
    elif rng.random() < 0.3:
        headers.append("Transfer-Encoding: chunked")
        body = (
            b"%x\r\n%b\r\n0\r\n\r\n" % (len(body), body)
            if rng.random() < 0.6
            else rng.choice([b"zz\r\n", b"-1\r\n", b"5\r\nab"]) + body
        )
    rng.shuffle(headers)
    ending = rng.choice(["\r\n"] * 40 + ["\n", "\r"])
    head = ending.join([f"{method} {path} {rng.choice(VERSIONS)}", *headers, "", ""]).encode(
        "utf-8", "surrogatepass"
    )
    whole = bytearray(head + body)
    if rng.random() < 0.15:
        for _ in range(rng.choice([1, 3, 20])):
            whole[rng.randrange(len(whole))] = rng.randrange(256)
    return bytes(whole) * rng.choice([1] * 20 + [2, 5])


def asked(port: int, sent: bytes, rng: random.Random) -> str:
    """The status of the first answer, or of a server's error; "cut" without any, "hung" where there
    is no end.
    """
    got = bytearray()
    with (
        contextlib.suppress(ConnectionError, OSError),
        socket.create_connection(("127.0.0.1", port)) as one,
    ):
        one.settimeout(PATIENCE)
        step = rng.choice([len(sent)] * 4 + [1 + len(sent) // 3])
        for at in range(0, len(sent), step):
            one.sendall(sent[at : at + step])
        one.settimeout(WAITING)
        try:
            while part := one.recv(65536):
                got += part
        except TimeoutError:
            # It waits for the rest of the request, or for another. There is none.
            one.shutdown(socket.SHUT_WR)
            one.settimeout(PATIENCE)
            try:
                while part := one.recv(65536):
                    got += part
            except TimeoutError:
                return "hung"
    said = [found.decode() for found in re.findall(rb"HTTP/1\.1 ([2-5]\d\d) ", bytes(got))]
    return max(filter(failed, said), default=said[0] if said else "cut")


def failed(status: str) -> bool:
    """Whether the server is to blame; 503 is how `/healthz` says that a camera is not at work."""
    return status == "hung" or (status >= "500" and status.isdecimal() and status != "503")


def memory(child: subprocess.Popen[str]) -> float:
    """MiB that the process has in memory."""
    text = Path(f"/proc/{child.pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+)", text)[1]) / 1024  # type: ignore[index]


def campaign(words: list[str], folder: Path, number: int, seed: int) -> dict[str, object]:
    """Start a page, ask it, and say what came of it."""
    statuses = Counter[str]()
    failures = list[dict[str, str]]()
    with (folder / "stderr").open("w+b") as stderr:
        child = subprocess.Popen(
            [sys.executable, "-m", "phdtrack", *words],
            cwd=folder,
            stdout=stderr,
            stderr=stderr,
            text=True,
        )
        try:
            while not (
                found := re.search(
                    r"the page: http://(127\.0\.0\.1:(\d+))/", (folder / "stderr").read_text()
                )
            ):
                if child.poll() is not None:
                    raise SystemExit((folder / "stderr").read_text())
                time.sleep(0.1)
            host = found[1]
            port = int(found[2])
            begun = time.monotonic()
            held = list[float]()

            def one(k: int) -> tuple[bytes, str]:
                rng = random.Random(f"{seed} {k}")
                sent = request(rng, host)
                return sent, asked(port, sent, rng)

            with ThreadPoolExecutor(SHARE) as pool:
                for k, (sent, status) in enumerate(pool.map(one, range(number))):
                    statuses[status] += 1
                    if failed(status):
                        failures.append({"status": status, "sent": repr(sent[:300])})
                    if k % max(1, number // 20) == 0:
                        held.append(memory(child))
            fine = f"GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode()
            with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as last:
                last.sendall(fine)
                alive = last.recv(12) == b"HTTP/1.1 200"
            seconds = time.monotonic() - begun
        finally:
            child.terminate()
            child.wait(60)
    said = (folder / "stderr").read_text()
    return {
        "command": " ".join(words),
        "requests": number,
        "seconds": round(seconds, 1),
        "statuses": dict(sorted(statuses.items())),
        "failures": failures,
        "tracebacks": said.split("Traceback")[1:][:20],
        "answers_afterwards": alive,
        "memory_mib": [round(one, 1) for one in held],
        # Of the second half: what is loaded once is loaded by then.
        "growth_mib": round(held[-1] - held[len(held) // 2], 1),
    }


def main() -> int:
    """Both pages."""
    given = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    given.add_argument("--number", type=int, default=10_000, help="requests to each page")
    given.add_argument("--out", type=Path, default=OUT)
    options = given.parse_args()
    found = list[dict[str, object]]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = [
            sys.executable,
            "-m",
            "phdtrack",
            "simulate",
            "street",
            "--out",
            "street",
            "--frames",
            "60",
            "--seed",
            "1",
        ]
        subprocess.run(program, cwd=folder, check=True, capture_output=True)
        (folder / "street" / "scene.mp4").rename(folder / "street.mp4")
        for seed, words in enumerate(
            (["label", "street.mp4", "--no-browser"], ["live", "gate=street.mp4", "--out", "live"])
        ):
            found.append(campaign(words, folder, options.number, seed))
            print(json.dumps(found[-1], indent=1))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(found, indent=1) + "\n")
    bad = [
        one
        for one in found
        if one["failures"]
        or one["tracebacks"]
        or not one["answers_afterwards"]
        or one["growth_mib"] > 20
    ]  # type: ignore[operator]
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
