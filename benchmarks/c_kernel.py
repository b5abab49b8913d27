"""The likelihood kernel against C: the same block of particles and the same detections, calls by
turns.

The C side is the best of what the compiler makes of `kernel.c` with -O3 -march=native and the
freedoms of -ffast-math: polynomial exp or the library's, at the compiler's own vector width or at
512 bits. Both sides sum the likelihoods and count those in the region; C writes each, too.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.parts import Outcome, Row, Scale, Skipped
from benchmarks.timing import Spread, in_turns
from phdtrack.kernels.particle_models import BLOCK, NORM, H, OwnSize, W, X, Y, prepare
from phdtrack.kernels.particles import DETECTED, ROWS, WEIGHT, evaluate

KEYS = ("c_kernel",)
SOURCE = Path(__file__).resolve().parent / "kernel.c"
# What -ffast-math lets the compiler do, spelt out: with the flag itself a shared library may bring
# start-up code that switches denormal numbers off in the whole process that loads it.
FAST = (
    "-fno-math-errno",
    "-fassociative-math",
    "-freciprocal-math",
    "-fno-signed-zeros",
    "-fno-trapping-math",
    "-ffinite-math-only",
)
FLAGS = ("-O3", "-march=native", *FAST, "-ffp-contract=fast", "-shared", "-fPIC")
VARIANTS = (
    ("polynomial", ("-DPOLYNOMIAL=1",)),
    ("polynomial, 512 bits", ("-DPOLYNOMIAL=1", "-mprefer-vector-width=512")),
    ("library", ("-DPOLYNOMIAL=0",)),
)
DETECTIONS = 64
CALLS = 200
REGION = 13.28
SENSOR = OwnSize(np.float32(0.15), np.float32(1.0))
F4 = NDArray[np.float32]


@njit
def numba_calls(sensor: OwnSize, s: F4, table: F4, region: np.float32, calls: int, out: F4) -> None:
    """``calls`` times all detections of ``table`` against the block ``s``; sums and counts into
    ``out`` (count, 2).
    """
    for i in range(BLOCK):
        prepare(sensor, s, i)
    for _ in range(calls):
        for j in range(table.shape[1]):
            out[j, 0], out[j, 1] = evaluate(sensor, table, j, s, BLOCK, region)


def block(rng: np.random.Generator) -> tuple[F4, F4]:
    """A block of particles about one target in the scratch layout, and a table of detections near
    it.
    """
    s = np.zeros(ROWS * BLOCK, np.float32)
    for row, mean, sd in ((X, 300, 3), (Y, 200, 5), (W, 35, 4), (H, 70, 8)):
        s[row : row + BLOCK] = rng.normal(mean, sd, BLOCK)
    s[WEIGHT : WEIGHT + BLOCK] = s[DETECTED : DETECTED + BLOCK] = 1
    around = np.array([[4], [7], [5], [10]]) * rng.standard_normal((4, DETECTIONS))
    return s, (np.array([[300], [200], [35], [70]]) + around).astype(np.float32)


def compiled(folder: Path) -> dict[str, Any]:
    """The variants that the compiler accepts, loaded; raises `Skipped` where there is no
    compiler.
    """
    compiler = next(
        (found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), None
    )
    if compiler is None:
        raise Skipped("no C compiler (cc, gcc, clang) on this machine")
    out = {}
    words = ""
    for number, (name, flags) in enumerate(VARIANTS):
        target = folder / f"kernel{number}.so"
        command = [compiler, *FLAGS, *flags, str(SOURCE), "-o", str(target), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            out[name] = ctypes.CDLL(str(target)).pair_sums
        words = done.stderr.strip()
    if not out:
        raise Skipped(f"the C compiler failed: {words.splitlines()[-1] if words else 'no word'}")
    return out


def caller(function: Any, s: F4, d: F4, out: F4) -> Callable[[], None]:
    """``CALLS`` calls of a C function on the block."""
    x, y, w, h, weight = (s[row : row + BLOCK] for row in (X, Y, W, H, WEIGHT))
    iw, ih = (1 / np.maximum(SENSOR.noise * size, SENSOR.min_noise) for size in (w, h))
    rows = np.concatenate([x, y, w, h, iw, ih, NORM * (iw * ih) ** 2, weight]).astype(np.float32)
    z = np.ascontiguousarray(d[:4].T)
    g = np.zeros(BLOCK, np.float32)
    pointer = ctypes.POINTER(ctypes.c_float)
    function.argtypes = [
        pointer,
        ctypes.c_int,
        pointer,
        ctypes.c_int,
        ctypes.c_float,
        pointer,
        pointer,
    ]
    function.restype = None
    keep = (rows, z, g, out)
    at = [array.ctypes.data_as(pointer) for array in keep]

    def call() -> None:
        for _ in range(CALLS):
            function(at[0], BLOCK, at[1], DETECTIONS, REGION, at[2], at[3])

    return call


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """Nanoseconds per pair of both, and the ratio."""
    s, d = block(np.random.default_rng(1))
    mine = np.zeros((DETECTIONS, 2), np.float32)
    with tempfile.TemporaryDirectory() as folder:
        functions = compiled(Path(folder))
        results = {name: np.zeros((DETECTIONS, 2), np.float32) for name in functions}
        calls = [lambda: numba_calls(SENSOR, s, d, np.float32(REGION), CALLS, mine)]
        calls += [caller(function, s, d, results[name]) for name, function in functions.items()]
        spent = in_turns(calls, scale.repeats, warm_up=2)
    for name, found in results.items():
        if not np.allclose(found[:, 0], mine[:, 0], rtol=1e-4) or not np.array_equal(
            found[:, 1], mine[:, 1]
        ):
            raise ArithmeticError(f"C ({name}) and Numba do not agree on the likelihoods")
    unit = 1e9 / (CALLS * DETECTIONS * BLOCK)
    ours = Spread.of(spent[0], unit)
    theirs = {
        name: Spread.of(times, unit) for name, times in zip(functions, spent[1:], strict=True)
    }
    name, best = min(theirs.items(), key=lambda item: item[1].median)
    ratio = ours.median / best.median
    rows = (
        Row("likelihood kernel, Numba", ours.median, "ns/pair", ours),
        Row(f"likelihood kernel, C ({name} exp)", best.median, "ns/pair", best),
        Row("Numba's time over C's", ratio, "×", most=1.5),
    )
    entry = {
        "ratio": ratio,
        "numba_ns": ours.as_dict(),
        "c_ns": {n: spread.as_dict() for n, spread in theirs.items()},
        "best": name,
    }
    return Outcome(rows, {"c_kernel": entry})
