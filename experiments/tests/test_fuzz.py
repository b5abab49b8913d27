"""Some hundred broken files for every reader, and the detection of failures."""

import random
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import ClassVar

import pytest

from experiments import fuzz
from phdtrack.errors import InputError

WHOLE = fuzz.Limits(seconds=60.0)


@pytest.mark.slow
def test_every_family_in_its_short_form(tmp_path: Path) -> None:
    """In a process without threads, because it is forked."""
    words = [sys.executable, "-m", "experiments.fuzz", "all", "--inputs", "80", "--seconds", "60"]
    done = subprocess.run(
        [*words, "--out", tmp_path], cwd=fuzz.ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert [line.partition(":")[0] for line in lines] == list(fuzz.FAMILIES)
    for family in fuzz.FAMILIES:
        report = fuzz.Report.of(tmp_path / f"fuzz-{family}.json", family, 0, WHOLE)
        assert report is not None
        assert (report.done, report.failed) == (80, 0)
        assert min(report.accepted, report.refused) > 0, family


def bad(content: bytes) -> None:
    """Reads numbers; some of them are too much for it."""
    kind = content[0]
    if kind == 0:
        raise InputError("no")
    if kind == 1:
        raise KeyError("a")
    if kind == 2:
        import os
        import signal

        os.kill(os.getpid(), signal.SIGSEGV)
    if kind == 3:
        time.sleep(3600)


def made(draw: random.Random) -> bytes:
    """One of the first twelve with seed 3 hangs."""
    return bytes([draw.randrange(5)])


def test_exceptions_crashes_and_hangs_are_found(tmp_path: Path) -> None:
    program = (
        "from pathlib import Path\nfrom experiments import fuzz\nfrom experiments.tests.test_fuzz"
        " import bad, made\nlimits = fuzz.Limits(5.0)\nreport = fuzz.campaign('bad', made, bad,"
        " inputs=12, seed=3, limits=limits,"
        f" kept=Path({str(tmp_path)!r}))\nfuzz.write(Path({str(tmp_path / 'bad.json')!r}),"
        " report)\n"
    )
    subprocess.run([sys.executable, "-c", program], cwd=fuzz.ROOT, check=True)
    report = fuzz.Report.of(tmp_path / "bad.json", "bad", 3, fuzz.Limits(5.0))
    assert report is not None
    kinds = [made(fuzz.random_of(3, index))[0] for index in range(12)]
    assert set(kinds) == {0, 1, 2, 3, 4}
    assert report.done == 12
    assert (report.accepted, report.refused) == (kinds.count(4), kinds.count(0))
    found = {one.kind: one for one in report.findings.values()}
    assert {kind: one.times for kind, one in found.items()} == {
        "KeyError": kinds.count(1),
        "crash": kinds.count(2),
        "hang": kinds.count(3),
    }
    assert found["crash"].what == "SIGSEGV"
    assert Path(found["KeyError"].file).read_bytes() == b"\x01"


def test_what_a_child_tells_is_never_there_in_part() -> None:
    class State(bytearray):
        written: ClassVar = []

        def __setitem__(self, where: slice, what: bytes) -> None:
            self.written.append((where, what))

    state = State(48)
    fuzz.tell(state, 3, 5.0, 1, 1, 1, 0.5)
    # Nothing else was changed in between.
    assert bytes(state) == bytes(48)
    assert State.written == [(slice(None), struct.pack("<qdqqqd", 3, 5.0, 1, 1, 1, 0.5))]


@pytest.mark.parametrize("family", ["detections", "cameras"])
def test_the_same_seed_makes_the_same_inputs(family: str) -> None:
    samples, _ = fuzz.FAMILIES[family]()
    one, other = (
        [fuzz.mutated(samples, fuzz.random_of(7, k)) for k in range(50)] for _ in range(2)
    )
    assert one == other
    assert len(set(one)) > 40
