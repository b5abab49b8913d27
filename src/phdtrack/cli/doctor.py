"""``phdtrack doctor``: versions, and what works on this machine: detectors, codecs, the cache of compiled kernels.

Every check does the thing itself where that is cheap (it makes a detector, opens an encoder) instead of trusting a version
number, and says how to mend what does not work. A check that is not essential may fail and phdtrack still does its main job.
"""

from __future__ import annotations

import platform
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module, metadata
from pathlib import Path

import typer

from phdtrack import __version__
from phdtrack.cli.output import Output

PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless", "av", "typer", "rich", "pydantic", "matplotlib", "pyarrow")
DECODERS = ("h264", "hevc", "vp9", "av1", "mpeg1video", "mpeg2video", "mpeg4", "mjpeg")
HEADLESS = "pip install 'opencv-python-headless>=4.8,<5'"


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was tried: ``detail`` says what came of it, ``cure`` how to mend it where it failed."""

    name: str
    ok: bool
    detail: str
    cure: str
    essential: bool


def doctor(output: Output) -> None:
    """Say what works on this machine, and how to mend what does not.

    Exit status 1 where something essential does not work.
    """
    checks, numbers = examine(), dict(versions())
    ok = all(check.ok for check in checks if check.essential)
    output.say(*(f"{name:24} {version or 'not installed'}" for name, version in numbers.items()), "")
    for check in checks:
        mark = "ok     " if check.ok else "MISSING" if check.essential else "absent "
        output.say(f"{mark}  {check.name}: {check.detail}", *([f"         {check.cure}"] if check.cure else []))
    sentence = "Everything essential works here." if ok else "Something essential does not work here: see MISSING above."
    output.say("", sentence)
    known = {name: version or None for name, version in numbers.items()}
    output.document({"ok": ok, "versions": known, "checks": [asdict(check) for check in checks]})
    if not ok:
        raise typer.Exit(1)


def examine() -> list[Check]:
    """Look at everything. Never raises: what fails is a check that failed."""
    found = []
    for name, trial, essential, cure in CHECKS:
        try:
            found.append(Check(name, True, trial(), "", essential))
        except Exception as error:  # whatever a broken installation raises is the finding
            found.append(Check(name, False, f"{type(error).__name__}: {error}", cure, essential))
    return found


def versions() -> tuple[tuple[str, str], ...]:
    """Pairs of name and version: phdtrack, Python, the system, the packages that phdtrack rests on; empty: not there."""
    own = (("phdtrack", __version__), ("python", platform.python_version()), ("system", platform.platform()))
    return (*own, *((name, _version(name)) for name in PACKAGES))


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""


def _opencv() -> str:
    others = [name for name in ("opencv-python", "opencv-contrib-python") if _version(name)]
    beside = f", and {' and '.join(others)} beside it: whichever was installed last is used" if others else ""
    return f"version {import_module('cv2').__version__}{beside}"


def _detector(name: str) -> str:
    import_module("phdtrack.detect").make_detector(name)
    return "can be made"


def _decoders() -> str:
    found = [name for name in DECODERS if name in import_module("av").codecs_available]
    if not found:
        raise RuntimeError("FFmpeg has no decoder for any usual video")
    return "reads " + ", ".join(found)


def _encoders() -> str:
    numpy, video = import_module("numpy"), import_module("phdtrack.video")
    with tempfile.TemporaryDirectory() as folder, video.VideoWriter(Path(folder) / "try.mp4", 64, 48, 25.0) as writer:
        for _ in range(3):
            writer.write(numpy.zeros((48, 64, 3), numpy.uint8))
    return "writes mp4 files that play in a browser"


def _kernels() -> str:
    numba = import_module("numba")
    if numba.njit(lambda x: x + 1)(1) != 2:
        raise RuntimeError("a compiled function gave a wrong result")
    state = "switched off by NUMBA_DISABLE_JIT" if numba.config.DISABLE_JIT else f"{numba.get_num_threads()} threads"
    return f"numba {numba.__version__}, {state}"


def _cache() -> str:
    cache = import_module("phdtrack.kernels").CACHE
    if not cache.lasting:
        raise RuntimeError("no folder can be written into, so every run compiles anew")
    state = f"warm, {cache.kept} kernels" if cache.kept else "cold, the first run compiles for some ten seconds"
    return f"{cache.folder} ({state})"


def _imported(module: str, package: str) -> str:
    import_module(module)
    return f"{package} {_version(package)}"


# Name for people, what is tried, whether it is essential, and what to do where it fails.
CHECKS: list[tuple[str, Callable[[], str], bool, str]] = [
    ("OpenCV", _opencv, True, HEADLESS),
    ("detector face (cascades)", partial(_detector, "face"), False, HEADLESS),
    ("detector person (HOG)", partial(_detector, "person"), False, HEADLESS),
    ("video in", _decoders, False, "pip install 'phdtrack[video]'; where it is installed: pip install --force-reinstall av"),
    ("video out (H.264)", _encoders, False, "pip install --force-reinstall av; or track with --no-video"),
    ("compiled kernels", _kernels, True, "pip install --force-reinstall numba"),
    ("cache of compiled kernels", _cache, False, "Set NUMBA_CACHE_DIR to a folder that can be written into."),
    (
        "report (plots)",
        partial(_imported, "matplotlib.backends.backend_agg", "matplotlib"),
        False,
        "pip install 'phdtrack[report]'; where it is installed: pip install --force-reinstall matplotlib",
    ),
    ("pages in the browser", partial(_imported, "uvicorn", "uvicorn"), False, "pip install 'phdtrack[web]'"),
    ("networks (ONNX)", partial(_imported, "onnxruntime", "onnxruntime"), False, "pip install 'phdtrack[onnx]'"),
    ("Parquet files", partial(_imported, "pyarrow.parquet", "pyarrow"), False, "pip install 'phdtrack[parquet]'"),
]
