"""Broken files for every reader: ``python -m experiments.fuzz FAMILY --inputs N --seed S [--jobs J]
[--out FILE.json]``.

Small valid samples are changed (bits, cuts, doubled spans, huge numbers, deep nesting, wrong
types), some inputs are random bytes. Each is read in a child process. An input passes if it is read
or refused with `InputError`. A finding is any other exception (warnings count), a process that
dies, exceeds the time limit of an input, or the memory limit. Its input is kept in a file named in
the report (its first byte is the number of the sample); index and seed reproduce it.

A stopped campaign continues from its report, with one process. `campaign` works for any pair of
functions that make bytes and read them.
"""

from __future__ import annotations

import argparse
import json
import mmap
import multiprocessing
import os
import random
import re
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from multiprocessing import connection
from pathlib import Path
from typing import Any

from phdtrack.errors import InputError

Make = Callable[[random.Random], bytes]
Try = Callable[[bytes], object]
ROOT = Path(__file__).resolve().parents[1]
# State of a child: index, start time, and numbers of accepted, refused and failed inputs, slowest
# time.
_STATE = struct.Struct("<qdqqqd")
_PAGE = os.sysconf("SC_PAGE_SIZE")
# Inputs per child; then a fresh one continues.
_BLOCK = 20_000


@dataclass(frozen=True, slots=True)
class Limits:
    """Seconds for one input, and bytes of memory beyond the initial use of a child."""

    seconds: float = 10.0
    memory: int = 1 << 30


@dataclass(slots=True)
class Finding:
    """A failure: the input that caused it, and the number of inputs with the same failure."""

    kind: str
    what: str
    index: int
    file: str
    times: int = 1


@dataclass(slots=True)
class _Child:
    """A process, the end of its span of inputs, the pipe of its messages, and its state."""

    process: Any
    end: int
    says: connection.Connection
    state: mmap.mmap
    base: int = 0
    suspect: int = -1

    def read(self) -> tuple[int, float, int, int, int, float]:
        """Index of the current input and its start time; numbers of accepted, refused and failed
        inputs; longest time.
        """
        found: tuple[int, float, int, int, int, float] = _STATE.unpack_from(self.state)
        return found


@dataclass(slots=True)
class Report:
    """The result of a campaign."""

    family: str
    inputs: int
    seed: int
    limits: Limits
    seconds: float = 0.0
    accepted: int = 0
    refused: int = 0
    failed: int = 0
    slowest: float = 0.0
    memory: int = 0
    findings: dict[str, Finding] = field(default_factory=dict)

    @property
    def done(self) -> int:
        """The number of inputs that were read."""
        return self.accepted + self.refused + self.failed

    def document(self) -> dict[str, Any]:
        """The report in the types of JSON."""
        more = {"done": self.done, "inputs_per_second": self.done / max(self.seconds, 1e-9)}
        return asdict(self) | more

    @classmethod
    def of(cls, file: Path, family: str, seed: int, bounds: Limits) -> Report | None:
        """The report of the same campaign in a file; None if there is none."""
        try:
            known = json.loads(file.read_text(encoding="utf-8"))
            limits = Limits(**known.pop("limits"))
            found = known.pop("findings")
            kept = {
                name: known[name] for name in known if name not in ("done", "inputs_per_second")
            }
            report = cls(
                **kept,
                limits=limits,
                findings={name: Finding(**one) for name, one in found.items()},
            )
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return (
            report
            if (report.family, report.seed, report.limits) == (family, seed, bounds)
            else None
        )


def random_of(seed: int, index: int) -> random.Random:
    """The random generator of one input."""
    return random.Random(seed * 1_000_003_000_003 + index)


def _rss(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE
    except (OSError, IndexError):
        return 0


def tell(state: Any, *values: float) -> None:
    """Write the state of a child in one assignment.

    ``pack_into`` first fills the buffer with 0: a child that is paused just then would seem to have
    begun long ago, and would be taken for a hanging one.
    """
    state[:] = _STATE.pack(*values)


def _child(
    make: Make,
    try_one: Try,
    span: tuple[int, int],
    seed: int,
    limits: Limits,
    says: Any,
    state: mmap.mmap,
) -> None:
    """Read a span of inputs; report each failure and continue with the next input."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    virtual = int(Path("/proc/self/statm").read_text().split()[0]) * _PAGE
    resource.setrlimit(resource.RLIMIT_AS, (virtual + 2 * limits.memory,) * 2)
    sys.stdout = sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    os.dup2(sys.stdout.fileno(), 2)
    os.dup2(sys.stdout.fileno(), 1)
    warnings.simplefilter("error")
    accepted = refused = failed = 0
    longest = 0.0
    for index in range(*span):
        content = make(random_of(seed, index))
        began = time.monotonic()
        tell(state, index, began, accepted, refused, failed, longest)
        try:
            try_one(content)
            accepted += 1
        except InputError:
            refused += 1
        except BaseException as error:
            failed += 1
            places = [
                f"{Path(f.filename).name}:{f.lineno}"
                for f in traceback.extract_tb(error.__traceback__)
            ]
            ours = [place for place in places if not place.startswith("fuzz")]
            says.send(
                (
                    index,
                    type(error).__name__,
                    f"{' '.join(ours[-4:])}: {str(error)[:200]}",
                    " ".join(ours[-4:]),
                )
            )
        longest = max(longest, time.monotonic() - began)
    tell(state, span[1], time.monotonic(), accepted, refused, failed, longest)
    says.send(None)


def campaign(
    family: str,
    make_inputs: Make,
    try_one: Try,
    *,
    inputs: int,
    seed: int = 0,
    jobs: int = 1,
    limits: Limits | None = None,
    kept: Path | None = None,
    progress: Callable[[Report], None] = lambda report: None,
    begun: Report | None = None,
) -> Report:
    """Read ``inputs`` inputs, and report the results.

    Parameters
    ----------
    family : name, for the report.
    make_inputs : the bytes of one input from its randomness; runs in the child and must not fail.
    try_one : reads them; returns if they are accepted, raises `InputError` if they are refused. It
        runs in a forked process: it may start threads, but this process must not have any.
    inputs, seed, jobs : number of inputs; seed; number of parallel processes.
    limits : for each input.
    kept : folder for the inputs of findings; None: a temporary one.
    progress : called after each child.
    begun : report of an earlier campaign to continue.

    Returns
    -------
    The report.
    """
    limits = limits or Limits()
    kept = kept or Path(tempfile.mkdtemp(prefix=f"fuzz-{family}-"))
    report = begun or Report(family, inputs, seed, limits)
    report.inputs = inputs
    began = time.monotonic() - report.seconds
    waiting = [(at, min(at + _BLOCK, inputs)) for at in range(report.done, inputs, _BLOCK)][::-1]
    running: list[_Child] = []
    context = multiprocessing.get_context("fork")

    def found(index: int, kind: str, what: str, key: str) -> None:
        if f"{kind} {key}" in report.findings:
            report.findings[f"{kind} {key}"].times += 1
            return
        kept.mkdir(parents=True, exist_ok=True)
        file = kept / f"{family}-{seed}-{index}.bin"
        file.write_bytes(make_inputs(random_of(seed, index)))
        report.findings[f"{kind} {key}"] = Finding(kind, what, index, str(file))

    def ended(child: _Child, kind: str = "", what: str = "") -> None:
        """Count the results of a child; after a failure, queue the inputs after the one at which it
        ended.
        """
        index, _, accepted, refused, failed, slowest = child.read()
        report.accepted = report.accepted + accepted
        report.refused = report.refused + refused
        report.failed = report.failed + failed
        report.slowest = max(report.slowest, slowest)
        running.remove(child)
        if kind:
            report.failed += 1
            found(index, kind, what, what)
            if index + 1 < child.end:
                waiting.append((index + 1, child.end))
        for file in _shared().glob(f"phdtrack-fuzz-{child.process.pid}.*"):
            file.unlink()
        report.seconds = time.monotonic() - began
        progress(report)

    while waiting or running:
        while waiting and len(running) < jobs:
            span = waiting.pop()
            hear, says = context.Pipe(duplex=False)
            state = mmap.mmap(-1, _STATE.size)
            tell(state, span[0], time.monotonic(), 0, 0, 0, 0.0)
            process = context.Process(
                target=_child,
                args=(make_inputs, try_one, span, seed, limits, says, state),
                daemon=True,
            )
            process.start()
            says.close()
            running.append(_Child(process, span[1], hear, state, _rss(process.pid or 0)))
        connection.wait([child.says for child in running], timeout=0.05)
        for child in list(running):
            _watch(child, limits, report, found, ended)
    report.seconds = time.monotonic() - began
    return report


def _watch(
    child: _Child,
    limits: Limits,
    report: Report,
    found: Callable[..., None],
    ended: Callable[..., None],
) -> None:
    """Read the messages of a child, and end it if it exceeds time or memory."""
    done = False
    try:
        while child.says.poll():
            message = child.says.recv()
            done = done or message is None
            if message is not None:
                found(*message)
    except EOFError:
        pass
    if done or not child.process.is_alive():
        child.process.join()
        code = child.process.exitcode
        name = signal.Signals(-code).name if code < 0 else f"exit {code}"
        ended(child) if done else ended(child, "crash", name)
        return
    used = _rss(child.process.pid)
    index, since, *_ = child.read()
    child.base = child.base or used
    report.memory = max(report.memory, used - child.base)
    # A state read while the child writes may mix two inputs, so it must be read twice.
    slow = time.monotonic() - since > limits.seconds
    large = used - child.base > limits.memory
    late = slow and child.suspect == index
    child.suspect = index if slow else -1
    if late or large:
        child.process.kill()
        child.process.join()
        ended(
            child,
            "hang" if late else "memory",
            f"more than {limits.seconds:g} s" if late else "above the bound",
        )


# ------------------------------------------------------------------------------------------------
# mutations

NUMBERS = (
    *(
        "0",
        "-0",
        "-1",
        "1e400",
        "-1e400",
        "1e-400",
        "nan",
        "inf",
        "-inf",
        "9" * 5000,
        "1e308",
        "4.9e-324",
        "0x10",
        "1_0",
    ),
    *(
        "1000000000",
        "9007199254740993",
        "9223372036854775808",
        "-9223372036854775809",
        "1e18",
        "1e19",
        "2147483648",
        "٣",
    ),
)
WORDS = (
    *(
        b"\0",
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"\r",
        b"\n",
        b"\r\n",
        b"\t",
        b",",
        b";",
        b'"',
        b"'",
        b"#",
        b"=",
        b"\\",
        b"\x1a",
    ),
    *(
        b"null",
        b"true",
        b"{}",
        b"[]",
        b'""',
        b"[[",
        b"]]",
        b"<",
        b"/>",
        b"<!--",
        b"<![CDATA[",
        b"&amp;",
        b"%YAML",
        b"\xed\xa0\x80",
    ),
    *(
        b"\xc3\x28",
        b"\xe2\x80\xa8",
        b"<!DOCTYPE x [<!ENTITY a 'b'>]>",
        b"NaN",
        b"Infinity",
        b"1979-05-27T07:32:00Z",
        b"'''",
        b'"""',
    ),
    b'<?xml version="1.0" encoding="utf-7"?>',
)
DEEP = (b"[", b'{"a":', b"<a>", b"(", b"a.", b"[[a]]\n", b"a={", b"-", b"- ")
_NUMBER = re.compile(rb"-?\d+(\.\d+)?(e[-+]?\d+)?")


def mutated(samples: Sequence[bytes], rng: random.Random) -> bytes:
    """A byte with the number of a sample, and the sample with a few changes; rarely random
    bytes.
    """
    which = rng.randrange(len(samples))
    content = (
        bytearray(samples[which])
        if rng.random() > 0.02
        else bytearray(rng.randbytes(rng.randrange(400)))
    )
    for _ in range(rng.choice((1, 1, 1, 1, 1, 1, 2, 2, 3, 6))):
        content = _CHANGES[rng.randrange(len(_CHANGES))](content, rng, samples)
    return bytes((which,)) + content


def _span(content: bytearray, rng: random.Random) -> tuple[int, int]:
    start = rng.randrange(len(content) + 1)
    return start, min(len(content), start + int(rng.paretovariate(0.7)))


def flip(content: bytearray, rng: random.Random, _: Sequence[bytes]) -> bytearray:
    """Flip a bit, or change a byte."""
    if content:
        at = rng.randrange(len(content))
        content[at] = (
            content[at] ^ (1 << rng.randrange(8))
            if rng.random() < 0.5
            else rng.choice((0, 255, 127, 128, 32, 48, 57, 10))
        )
    return content


def cut(content: bytearray, rng: random.Random, _: Sequence[bytes]) -> bytearray:
    """Remove the end."""
    return content[: rng.randrange(len(content) + 1)]


def drop(content: bytearray, rng: random.Random, _: Sequence[bytes]) -> bytearray:
    """Remove a span."""
    start, end = _span(content, rng)
    return content[:start] + content[end:]


def double(content: bytearray, rng: random.Random, _: Sequence[bytes]) -> bytearray:
    """Repeat a span."""
    start, end = _span(content, rng)
    times = rng.choice((1, 1, 1, 2, 10, 1000)) if end - start < 100 else 1
    return content[:end] + content[start:end] * times + content[end:]


def number(content: bytearray, rng: random.Random, _: Sequence[bytes]) -> bytearray:
    """Replace a number by another."""
    found = [m.span() for m in _NUMBER.finditer(content)]
    if not found:
        return content
    start, end = rng.choice(found)
    return content[:start] + rng.choice(NUMBERS).encode() + content[end:]


def word(content: bytearray, rng: random.Random, _: Sequence[bytes]) -> bytearray:
    """Insert a token that has a meaning in some format."""
    at = rng.randrange(len(content) + 1)
    return content[:at] + rng.choice(WORDS) + content[at:]


def splice(content: bytearray, rng: random.Random, samples: Sequence[bytes]) -> bytearray:
    """Join the beginning of one sample and the end of another."""
    other = rng.choice(samples)
    return content[: rng.randrange(len(content) + 1)] + other[rng.randrange(len(other) + 1) :]


def swap(content: bytearray, rng: random.Random, _: Sequence[bytes]) -> bytearray:
    """Exchange two lines."""
    lines = content.split(b"\n")
    i = rng.randrange(len(lines))
    j = rng.randrange(len(lines))
    lines[i], lines[j] = lines[j], lines[i]
    return bytearray(b"\n".join(lines))


def deep(content: bytearray, rng: random.Random, _: Sequence[bytes]) -> bytearray:
    """Insert very deep nesting, rarely: it takes long to read."""
    if rng.random() > 0.05:
        return flip(content, rng, ())
    at = rng.randrange(len(content) + 1)
    return content[:at] + rng.choice(DEEP) * rng.choice((30, 1100, 20_000)) + content[at:]


def value(content: bytearray, rng: random.Random, _: Sequence[bytes]) -> bytearray:
    """Replace the type of a JSON value, or remove it; the same for attributes of XML."""
    if content[:1] in (b"<",):
        found = [m.span() for m in re.finditer(rb'\w+="[^"]*"', content)]
        start, end = rng.choice(found) if found else (0, 0)
        return (
            content[:start]
            + rng.choice((b"", b'id=""', b'xc="' + rng.choice(NUMBERS).encode() + b'"'))
            + content[end:]
        )
    if content[:1] not in (b"{", b"["):
        return number(content, rng, ())
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return flip(content, rng, ())
    new: Any = rng.choice(
        (
            None,
            True,
            "",
            "a",
            [],
            {},
            [[]],
            -1,
            1e300,
            10**400,
            10**18,
            0.5,
            "12",
            {"a": [1]},
            [1] * 5,
        )
    )
    parent = None
    key = None
    at = document
    while isinstance(at, (dict, list)) and at and rng.random() < 0.9:
        parent = at
        key = rng.choice(list(at)) if isinstance(at, dict) else rng.randrange(len(at))
        at = at[key]
    if parent is None:
        document = new
    elif rng.random() < 0.2:
        del parent[key]
    else:
        parent[key] = new
    return bytearray(json.dumps(document).encode())


_CHANGES = (
    flip,
    cut,
    drop,
    double,
    number,
    number,
    number,
    word,
    splice,
    swap,
    deep,
    value,
    value,
    value,
    value,
)

# ------------------------------------------------------------------------------------------------
# families

Sample = tuple[str | bytes, Callable[[Path], object]]


def in_file(content: bytes, suffix: str) -> Path:
    """A file of this process with the content; in memory if the system has such a folder."""
    path = _shared() / f"phdtrack-fuzz-{os.getpid()}{suffix}"
    with open(path, "wb", buffering=0) as file:
        file.write(content)
    return path


@cache
def _shared() -> Path:
    return Path("/dev/shm" if Path("/dev/shm").is_dir() else tempfile.gettempdir())


def reading(samples: Sequence[Sample], suffix: str) -> tuple[list[bytes], Try]:
    """The contents of samples, and a function that reads the output of `mutated` with the reader of
    its sample.
    """

    def read(content: bytes) -> None:
        samples[content[0]][1](in_file(content[1:], suffix))

    return [
        content.encode() if isinstance(content, str) else content for content, _ in samples
    ], read


def _detections() -> tuple[list[bytes], Try]:
    from phdtrack.formats import read_detections, read_warps

    rows = [(1 + k // 3, -1, 10 + k, 20 + 2 * k, 30, 60, 0.9) for k in range(9)]
    text = "".join(",".join(map(str, row)) + ",-1,-1,-1,1\n" for row in rows)
    covariance = "".join("1,-1,5,5,9,9,.5,-1,-1,-1,0,4,0,0,0,4,0,0,4,0,4\n" for _ in range(3))
    named = "frame;x1;y1;x2;y2;score;class\n" + "".join(
        f"{f};{a};{b};{a + c};{b + d};{s};car\n" for f, _, a, b, c, d, s in rows
    )
    blanks = "".join(" ".join(map(str, row)) + "\n" for row in rows)
    results = [
        {"image_id": f, "category_id": 1, "bbox": [a, b, c, d], "score": s}
        for f, _, a, b, c, d, s in rows
    ]
    images = [{"id": 7 + k, "file_name": f"img/{k:06d}.jpg", "video_id": 1} for k in range(1, 4)]
    annotations = [
        {
            "id": k,
            "image_id": 7 + f,
            "category_id": 2,
            "bbox": [a, b, 3, 4],
            "attributes": {"track_id": k},
        }
        for k, (f, _, a, b, *_) in enumerate(rows)
    ]
    data = {"images": images, "annotations": annotations, "categories": [{"id": 2, "name": "car"}]}
    kitti = (
        "0 1 Car 0 0 -1 10 20 30 40 -1 -1 -1 -1 -1 -1 -1 0.9\n" * 2
        + "1 -1 DontCare -1 -1 -10 1 2 3 4"
        + " -1" * 7
        + " 0\n"
    )
    warps = "frame,g11,g12,g13,g21,g22,g23\n2,1,0,3,0,1,4\n3,1,0,0,0,1,0\n"
    texts = [text, covariance, named, blanks, json.dumps(results), json.dumps(data), kitti]
    samples: list[Sample] = [(one, read_detections) for one in texts]
    return reading([*samples, (warps, read_warps)], ".txt")


def _truth() -> tuple[list[bytes], Try]:
    import numpy as np

    from phdtrack.formats import (
        ignoring,
        read_seqinfo,
        read_tracks,
        read_tracks_named,
        read_truth,
        read_truth_by_class,
    )
    from phdtrack.types import Truth

    none = Truth(*(np.zeros(0, np.int64),) * 2, np.zeros((0, 4)), np.zeros(0, np.bool_))
    mot = "".join(
        f"{f},{i},{10 * i + f},20,30,60,1,{1 + i % 8},1\n" for f in range(1, 4) for i in range(1, 4)
    )
    tracks = "".join(
        f"{f},{i},{10 * i + f},20,30,60,.9,-1,-1,-1,0,1,2\n"
        for f in range(1, 4)
        for i in range(1, 4)
    )
    named = (
        "frame,id,left,top,width,height,distractor,class\n1,1,5,5,9,9,0,car\n1,2,5,5,9,9,1,bus\n"
        "2,1,6,5,9,9,0,car\n"
    )
    regions = "frame,x,y,w,h\n,10,10,50,50\n2,0,0,5,5\n"
    kitti = (
        "0 1 Car 0 0 -1 10 20 30 60"
        + " -1" * 7
        + "\n1 -1 DontCare -1 -1 -10 1 2 3 4"
        + " -1" * 7
        + "\n"
    )
    info = (
        "[Sequence]\nname=A\nimDir=img1\nframeRate=25\nseqLength=100\nimWidth=640\nimHeight=480\n"
        "imExt=.jpg\n"
    )
    entries = [
        {"image_id": 1, "track_id": k, "category_id": 1, "bbox": [k, k, 9, 9], "iscrowd": k % 2}
        for k in range(3)
    ]
    samples: list[Sample] = [
        (mot, read_truth),
        (named, read_truth),
        (json.dumps(entries), read_truth),
        (tracks, read_tracks),
    ]
    samples += [
        (named, read_tracks_named),
        (named, read_truth_by_class),
        (kitti, partial(read_truth, kitti="Car")),
    ]
    samples += [
        (regions, partial(ignoring, none)),
        (tracks, partial(ignoring, none)),
        (info, read_seqinfo),
    ]
    return reading(samples, ".txt")


_TSAI = """<?xml version="1.0" encoding="UTF-8"?>
<Camera name="View"><Geometry width="768" height="576" ncx="795" nfx="750" dx="4.8e-3" dy="4.6e-3"
dpx="5.1e-3" dpy="4.6e-3"/>
<Intrinsic focal="5.5" kappa1="5e-3" cx="370" cy="280" sx="1.08"/>
<Extrinsic tx="828.7" ty="-3175.5" tz="35469.3" rx="2.04" ry="-0.893" rz="-0.43"/></Camera>
"""


def _xml() -> tuple[list[bytes], Try]:
    from phdtrack.formats import read_detections, read_truth
    from phdtrack.ground import read_camera

    boxes = "".join(
        f'<frame number="{f}"><objectlist><object id="{f % 3}"><box xc="{50 + f}" yc="60" w="20"'
        ' h="40"/></object></objectlist><grouplist><group id="9"><box xc="50" yc="60" w="20"'
        ' h="40"/></group></grouplist></frame>\n'
        for f in range(4)
    )
    cvml = f'<?xml version="1.0" encoding="UTF-8"?>\n<dataset name="a">{boxes}</dataset>\n'
    readers = [
        (cvml, read_truth),
        (cvml, read_detections),
        (_TSAI, read_camera),
        (_storages()[1], read_camera),
    ]
    return reading(readers, ".xml")


def _storages() -> list[bytes]:
    """An OpenCV camera as YAML, XML and JSON."""
    import cv2
    import numpy as np

    found = []
    for kind in ("yml", "xml", "json"):
        storage = cv2.FileStorage(f"a.{kind}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
        storage.write("image_width", 768)
        storage.write("camera_matrix", np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]]))
        storage.write("distortion_coefficients", np.array([[-0.2], [0.1], [0], [0], [0]]))
        storage.write("rvec", np.array([[1.9], [0.1], [0.2]]))
        storage.write("tvec", np.array([[0.5], [0.7], [9.0]]))
        found.append(storage.releaseAndGetString().encode())
    return found


def _cameras() -> tuple[list[bytes], Try]:
    from phdtrack.ground import read_camera
    from phdtrack.ground.terrain import read_terrain

    matrix = [[0.01, 0.002, -3.0], [0.0003, -0.02, 4.0], [1e-5, 2e-3, 1.0]]
    text = "\n".join(" ".join(map(str, row)) for row in matrix) + "\n"
    plain = {
        "mtx": [[800.0, 0, 320], [0, 800, 240], [0, 0, 1]],
        "dist": [[-0.2, 0.1, 0, 0, 0]],
        "rvec": [1.9, 0.1, 0.2],
    }
    toml = (
        f'homography = {matrix}\nmaps = "pixel-to-ground"\npixel = "xy"\nunit = "cm"\ninside ='
        " [300, 400]\n"
    )
    grid = (
        "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 2.5\nNODATA_value -9\n1 2 3\n4 5 -9\n"
    )
    texts = [text, json.dumps(plain | {"tvec": [0.5, 0.7, 9.0]}), toml, *_storages()[:2]]
    samples: list[Sample] = [(one, read_camera) for one in texts]
    return reading([*samples, (grid, read_terrain)], ".cam")


def _toml() -> tuple[list[bytes], Try]:
    from phdtrack.config import load

    text = """preset = "default"
[filter]
kind = "pmb"
gate_probability = 0.999
[sensor]
detection_probability = 0.9
box_noise = 0.1
[clutter]
clutter_per_frame = 2.5
[associate]
min_track_length = 3
max_coast = 0.4
[classes]
each = ["car.sensor.box_noise=0.2"]
together = [["car", "truck"]]
"""
    other = (
        '[filter]\nkind = "gm-phd"\n[birth]\nbirths_per_detection = 0.1\n[motion]\nacceleration ='
        " 0.1\n"
    )
    return reading([(text, load), (other, load)], ".toml")


def _scenes() -> tuple[list[bytes], Try]:
    from phdtrack.scene import read_scene

    def density(dim: int) -> dict[str, Any]:
        cov = [[4.0 * (i == j) for j in range(dim)] for i in range(dim)]
        mean = [[50.0 + 9 * i for i in range(dim)], [80.0] * dim]
        inner = {
            "low": [0.0] * dim,
            "high": [640.0] * dim,
            "weight": [0.6, 0.4],
            "mean": mean,
            "covariance": [cov, cov],
        }
        return {"rate": 0.2, "samples": 40, "uniform": 0.2} | inner

    scene = {
        "format": 1,
        "width": 640,
        "height": 480,
        "rate": 25.0,
        "source": "a.mp4",
        "births": density(6),
        "clutter": density(4),
        "followed": {"share": 0.1, "objects": density(4)},
        "notes": {"a": 1},
    }
    other = scene | {"births": density(4), "followed": None}
    return reading([(json.dumps(scene), read_scene), (json.dumps(other), read_scene)], ".json")


def _places() -> tuple[list[bytes], Try]:
    from phdtrack.live.zones import read_places

    text = """[[line]]
name = "door"
points = [[100, 400], [300, 400]]
[[zone]]
name = "shop"
points = [[400, 300], [600, 300], [600, 450.5], [400, 450]]
anchor = "centre"
classes = ["person"]
"""

    def read(path: Path) -> None:
        for place in read_places(path):
            place.distance((10.0, 20.0))
            place.crossings((0.0, 0.0), (500.0, 500.0))

    return reading([(text, read)], ".toml")


def _videos() -> tuple[list[bytes], Try]:
    return reading([(clip, _watched) for clip in _clips()], ".mp4")


def _watched(path: Path) -> None:
    from phdtrack.video import open_source

    for number, _ in enumerate(open_source(path)):
        if number > 200:
            break


@cache
def _clips() -> tuple[bytes, ...]:
    """Short clips of several containers and codecs, made in a separate process, because encoders
    start threads.
    """
    with (
        tempfile.TemporaryDirectory() as folder,
        multiprocessing.get_context("spawn").Pool(1) as pool,
    ):
        return tuple(pool.apply(_encoded, (folder,)))


def _encoded(folder: str) -> list[bytes]:
    import av
    import numpy as np

    found = []
    for kind, codec in (
        ("mp4", "libx264"),
        ("matroska", "mpeg4"),
        ("avi", "mjpeg"),
        ("mpegts", "mpeg4"),
        ("mp4", "mpeg4"),
    ):
        path = os.path.join(folder, f"a.{kind}")
        with av.open(path, "w", format=kind) as container:
            stream = container.add_stream(codec, rate=25)
            stream.width = 64
            stream.height = 48
            stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            for k in range(6):
                image = np.full((48, 64, 3), 60, np.uint8)
                image[16:32, 2 * k : 2 * k + 12] = (40, 120, 220)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
            container.mux(stream.encode(None))
        found.append(Path(path).read_bytes())
    return found


def _annotations() -> tuple[list[bytes], Try]:
    """Files of all formats that `formats` reads, each read as detections, tracks and truth."""
    texts = [*_benchmark_texts(), *_json_annotations(), *_xml_annotations(), *_exported()]
    return reading([(one, _read_as_all) for one in texts], ".txt")


def _benchmark_texts() -> list[str | bytes]:
    """Texts of ten benchmarks and programs."""
    ends = {
        "mot15": ("1,-1,-1,-1", "0,-1,-1,-1"),
        "mot17": ("1,1,0.9", "0,8,0.2"),
        "own": ("1,3,1.0", "1,0,1.0"),
        "words": ("1,car,1", "1,bus,1"),
        "boxmot": ("0,0,-1", "1,2,-1"),
        "uavdt": ("1,1,1", "2,4,3"),
        "visdrone": ("1,4,0,1", "0,0,0,0"),
        "regions": ("1,1,1", "0,1,0.5"),
        "run": ("0.9,-1,-1,-1,0,1,2", "0.5,-1,-1,-1,-1,1,1"),
    }
    texts = list[str | bytes]()
    for name, (first, second) in ends.items():
        identity = -1 if name == "regions" else 2
        texts.append(
            "".join(
                f"{k},1,{5 * k},20,30,60,{first}\n{k},{identity},{9 * k},50,20,60,{second}\n"
                for k in range(1, 5)
            )
        )
    kitti = " -1" * 7
    texts.append(
        f"0 1 Car 0 0 -1 10 20 30 60{kitti} 0.9\n1 -1 DontCare -1 -1 -10 1 2 3 4{kitti} 0\n"
    )
    texts.append(
        "frame;track_id;cx;cy;w;h;conf;class\n1;1;50;60;9;9;87;car\n2;1;50;60;9;9;95;bus\n"
    )
    return texts


def _json_annotations() -> list[str | bytes]:
    """COCO, its results, JSON lines and Scalabel."""
    names = ("a/000000.jpg", "a/000001.jpg", "b/000000.jpg", "b/000001.jpg")
    hashed = [f"clip-{k}_jpg.rf.{k}ca4238a0b923820dcc509a6f75849b.jpg" for k in range(4)]
    files = list[str | bytes]()
    for group, more in (
        (names, {}),
        (hashed, {}),
        (("x.png",) * 4, {"videos": [{"id": 1, "name": "v"}, {"id": 2, "name": "w"}]}),
    ):
        images = [
            {"id": k, "file_name": name, "video_id": 1 + k // 3 if more else 1}
            for k, name in enumerate(group)
        ]
        boxes = [
            {
                "image_id": k,
                "bbox": [9 * k, 5, 30, 40],
                "category_id": 1,
                "segmentation": [[1, 2, 5, 2, 4, 9]],
                "attributes": {"track_id": 1, "rotation": 45.0 * k},
            }
            for k in range(4)
        ]
        boxes.append({"image_id": 0, "segmentation": [[1, 2, 5, 2, 4, 9]], "track_id": 7})
        categories = [{"id": 1, "name": "car"}]
        data = {"images": images, "annotations": boxes, "categories": categories, **more}
        files.append(json.dumps(data))
    rows = [{"image_id": k, "track_id": 1, "bbox": [k, 2, 3, 4], "score": 0.5} for k in range(4)]
    files.append(json.dumps(rows))
    lines = [{"frame": k, "id": 1, "bbox": [k, 2, 3, 4], "class": "car"} for k in range(1, 5)]
    files.append("\n".join(map(json.dumps, lines)))
    label = {"id": "01", "category": "car", "box2d": {"x1": 1, "y1": 2, "x2": 9, "y2": 8}}
    frames = [
        {"name": f"v-{k}.jpg", "videoName": "v", "frameIndex": k, "labels": [label]}
        for k in range(3)
    ]
    return [*files, json.dumps(frames), json.dumps({"frames": frames})]


def _xml_annotations() -> list[str | bytes]:
    """CVAT for video and for images, and UA-DETRAC."""
    box = 'xtl="1" ytl="2" xbr="40" ybr="30"'
    shapes = (
        f'<box frame="0" outside="0" {box} rotation="30"><attribute name="a">b</attribute></box>',
        '<polygon frame="1" outside="0" points="1,2;9,2;5,8"/>',
        '<ellipse frame="2" cx="9" cy="9" rx="3" ry="2" rotation="10"/>',
        '<mask frame="3" left="1" top="2" width="3" height="4" rle="1, 2"/>',
        '<polyline frame="4" points="1,2;3,4"/>',
        f'<box frame="5" outside="1" {box}/>',
    )
    video = f'<annotations><track id="1" label="car">{"".join(shapes)}</track></annotations>'
    image = f'<image id="2" name="c.png" width="64" height="48"><box label="car" {box}/></image>'
    target = (
        '<target id="1"><box left="1" top="2" width="30" height="40"/>'
        '<attribute vehicle_type="car"/></target>'
    )
    detrac = (
        '<?xml version="1.0"?>\n<sequence name="M"><ignored_region><box left="1" top="2" width="9"'
        f' height="9"/></ignored_region>\n<frame num="1"><target_list>{target}</target_list>'
        f'</frame>\n<frame num="2"><target_list>{target}</target_list></frame></sequence>'
    )
    return [video, f"<annotations>{image}</annotations>", detrac]


def _exported() -> list[str | bytes]:
    """A few tracks in each format that can be written, Parquet among them."""
    import numpy as np

    from phdtrack.formats import EXPORTS, export_tracks
    from phdtrack.types import SequenceInfo, Tracks

    frame = np.array([1, 1, 2, 4])
    identity = np.array([1, 2, 1, 2])
    box = np.array([[10.0, 20, 40, 80], [90, 20, 120, 80], [12, 20, 42, 80], [91, 20, 121, 80]])
    tracks = Tracks.of(frame, identity, box, 0.9, -1)
    found = list[str | bytes]()
    with tempfile.TemporaryDirectory() as folder:
        for kind in EXPORTS:
            path = Path(folder) / f"tracks.{kind}"
            info = SequenceInfo(320, 240, 25.0, 4, "a")
            export_tracks(path, tracks, kind, {0: "car"}, info)
            found.append(path.read_bytes())
    return found


def _read_as_all(path: Path) -> None:
    """Read a file as detections, tracks and truth, and as content for labels. Raises `InputError`
    if all of them refuse it.
    """
    from phdtrack.formats import (
        Conventions,
        read_detections,
        read_tracks_named,
        read_truth,
        read_truth_by_class,
    )
    from phdtrack.formats.annotations import read_annotated

    notices = list[str]()
    stated = Conventions(box="ltrb", units="shares", sequence="a", frame_size=(320, 240))
    readers: list[Callable[[], object]] = [
        lambda: read_detections(path, notices=notices),
        lambda: read_tracks_named(path, notices=notices),
        lambda: read_truth(path, notices=notices),
        lambda: read_truth_by_class(path, notices=notices),
        lambda: read_truth(path, conventions=stated, notices=notices),
        lambda: read_annotated(path),
    ]
    refused = list[InputError]()
    for read in readers:
        try:
            read()
        except InputError as error:
            refused.append(error)
    if len(refused) == len(readers):
        raise refused[0]


def _scored() -> tuple[list[bytes], Try]:
    """Files of tracks, evaluated against a small truth."""
    import numpy as np

    from phdtrack.metrics import evaluate
    from phdtrack.run.scored_files import ScoringRequest, read_scored

    good = "".join(f"{k},1,{5 * k},20,30,60,1,-1,-1,-1\n" for k in range(1, 9))
    truth = Path(tempfile.mkdtemp(prefix="fuzz-truth-")) / "gt.txt"
    truth.write_text(good)
    ignore = truth.with_name("ignore.csv")
    ignore.write_text("frame,x,y,w,h\n,1,1,30,30\n")

    def read(path: Path) -> None:
        files = read_scored(ScoringRequest(truth, path, ignore=ignore))
        if files.frames < 1000 and np.abs(files.tracks.xyxy).max(initial=0) < 1e6:
            evaluate(files.truth, files.tracks, frames=files.frames)

    corners = "".join(f"{k},1,{5 * k},20,{5 * k + 30},80,1\n" for k in range(1, 9))
    return reading([(good, read), (corners, read), ("", read)], ".txt")


FAMILIES: dict[str, Callable[[], tuple[list[bytes], Try]]] = {
    "detections": _detections,
    "truth": _truth,
    "xml": _xml,
    "annotations": _annotations,
    "scored": _scored,
    "cameras": _cameras,
    "toml": _toml,
    "scenes": _scenes,
    "places": _places,
    "videos": _videos,
}


def write(file: Path, report: Report) -> None:
    """Write the report as JSON."""
    file.write_text(json.dumps(report.document(), indent=1) + "\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; the exit status is 1 if there are findings."""
    out = argparse.ArgumentParser(prog="python -m experiments.fuzz", description=__doc__)
    out.add_argument("family", choices=[*FAMILIES, "all"])
    out.add_argument("--inputs", type=int, default=1000, metavar="N")
    out.add_argument("--seed", type=int, default=0, metavar="S")
    out.add_argument("--jobs", type=int, default=1, metavar="J")
    out.add_argument(
        "--seconds", type=float, default=Limits().seconds, metavar="S", help="for one input"
    )
    out.add_argument(
        "--out", type=Path, metavar="PATH", help="FILE.json, or a folder; default: runs/reliability"
    )
    parsed = out.parse_args(arguments)
    worst = 0
    limits = Limits(parsed.seconds)
    for family in FAMILIES if parsed.family == "all" else [parsed.family]:
        samples, try_one = FAMILIES[family]()
        file = parsed.out or ROOT / "runs" / "reliability"
        file = file if file.suffix == ".json" else file / f"fuzz-{family}.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        report = campaign(
            family,
            partial(mutated, samples),
            try_one,
            inputs=parsed.inputs,
            seed=parsed.seed,
            jobs=parsed.jobs,
            kept=file.parent / "fuzz-findings",
            progress=partial(write, file),
            limits=limits,
            begun=Report.of(file, family, parsed.seed, limits) if parsed.jobs == 1 else None,
        )
        rate = report.done / max(report.seconds, 1e-9)
        print(
            f"{family}: {report.done} inputs in {report.seconds:.0f} s ({rate:.0f} a second): "
            f"{report.accepted} read, {report.refused} refused, {len(report.findings)} findings",
            flush=True,
        )
        for one in report.findings.values():
            print(f"  {one.kind} {one.what} ({one.times} times; {one.file})", flush=True)
        worst = max(worst, bool(report.findings))
    return worst


if __name__ == "__main__":
    raise SystemExit(main())
