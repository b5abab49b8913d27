"""Parts that are measured by one function each: Gaussian filters, extraction, association,
detectors, the whole process.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from benchmarks.parts import Outcome, Row, Scale, Skipped
from benchmarks.timing import Spread, exponent


def _module(name: str) -> Any:
    """A module beside this one; raises `Skipped` where it, or what it imports, is missing."""
    try:
        return importlib.import_module(f"benchmarks.{name}")
    except ModuleNotFoundError as missing:
        raise Skipped(f"{missing.name} is not there") from missing


def gm_phd(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """µs per step of the GM-PHD filter at every size."""
    return _steps("gm_phd", "GM-PHD", 1.1, scale, say)


def pmb(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """µs per step of the PMB filter at every size."""
    return _steps("pmb", "PMB", 1.1, scale, say)


def _steps(
    name: str,
    title: str,
    most: float | None,
    scale: Scale,
    say: Callable[[str], None],
) -> Outcome:
    """µs per step of the filter that the module ``name`` measures, and how they grow, by no more
    than to the ``most``-th.
    """
    measure = _module(name).measure
    rows = []
    us = {}
    details = {}
    for targets in scale.sizes:
        say(f"{targets} targets")
        found = measure(targets, seed=1, frames=min(scale.frames, 60))
        us[str(targets)] = found["us"]
        details[str(targets)] = found
        rows.append(
            Row(
                f"{title}, {targets} targets",
                found["us"],
                "µs",
                Spread(**found["spread"]),
                note=_rest(found, "us", "cpu"),
                cpu=found["cpu"],
            )
        )
    growth = exponent([float(n) for n in us], list(us.values()))
    rows.append(
        Row(
            f"{title}, growth exponent, {scale.sizes[0]} … {scale.sizes[-1]} targets",
            growth,
            "",
            most=most,
        )
    )
    return Outcome(
        tuple(rows), {f"{name}_us": us, name: {"growth_exponent": growth, "runs": details}}
    )


def extraction(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """ms per frame of both extractors, on the filter's own intensities."""
    measure = _module("extraction").measure
    rows = []
    entry: dict[str, dict[str, Any]] = {"kmeans": {}, "mixture": {}}
    for kind, sizes in entry.items():
        for targets in scale.sizes[::2]:
            say(f"{kind}, {targets} targets")
            found = sizes[str(targets)] = measure(targets, kind, frames=2)
            rows.append(
                Row(f"{kind}, {targets} targets", found["ms"], "ms", note=_rest(found, "ms"))
            )
    return Outcome(tuple(rows), {"extraction": entry})


def association(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """µs per frame of the association."""
    measure = _module("association").measure
    rows = []
    entry = {}
    for targets in scale.sizes[::2]:
        say(f"{targets} targets")
        found = entry[str(targets)] = measure(targets)
        rows.append(
            Row(
                f"association, {targets} targets",
                found["median"],
                "µs",
                note=_rest(found, "median"),
            )
        )
    return Outcome(tuple(rows), {"association": entry})


def detectors(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """ms per frame of every detector at QCIF, 768 × 576 and 1080p."""
    if not scale.others:
        raise Skipped("not in this scale")
    module = _module("detectors")
    rows = []
    entry: dict[str, dict[str, Any]] = {}
    # Outer loop over the sizes: frames are rendered once for each.
    for size in module.SIZES:
        for detector in module.DETECTORS:
            say(f"{detector}, {size}")
            frames = (
                scale.repeats if detector not in module.LEARNING else max(3, scale.repeats // 5)
            )
            found = module.measure(module.SIZES[size], detector, frames=frames)
            entry.setdefault(size, {})[detector] = found
            note = f"{found['detections']:.1f} boxes a frame"
            rows.append(
                Row(f"{detector}, {size}", found["ms"], "ms", Spread(**found["spread"]), note=note)
            )
    return Outcome(tuple(rows), {"detectors": entry})


def process(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """Whole-process frames per second of `phdtrack track` on the PETS video, by detector."""
    if not scale.others:
        raise Skipped("not in this scale")
    module = _module("process")
    rows = []
    entry: dict[str, Any] = {}
    # The video takes half a minute with each: quick has the default detector only.
    for detector in module.DETECTORS if scale.name == "full" else module.DETECTORS[:1]:
        say(detector)
        found = module.measure(detector=detector)
        if found["frames_per_second"] is None:
            raise Skipped(found["reason"])
        entry[detector] = found
        note = f"without start and report {found['without_start']:.0f} frames/s; stages, ms: "
        note += ", ".join(f"{name} {ms:.2g}" for name, ms in found["stage_ms"].items())
        rows.append(
            Row(f"{found['video']}, {detector}", found["frames_per_second"], "frames/s", note=note)
        )
    return Outcome(tuple(rows), {"process": entry})


def first_use(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """Seconds of compiling with an empty cache, and to the first frame with a full one."""
    if not scale.others:
        raise Skipped("not in this scale")
    found = _module("compile").measure()
    rows = (
        Row("compiling all kernels of phdtrack track", found["compile_s"], "s"),
        Row("to the first frame, first use", found["first_use_s"], "s"),
        Row("to the first frame, cached", found["start_s"], "s"),
    )
    return Outcome(rows, {"first_use": found})


def _rest(found: dict[str, Any], *but: str) -> str:
    """The other numbers of a measurement in a few words."""
    words = [
        f"{key} {value:.3g}"
        for key, value in found.items()
        if isinstance(value, (int, float)) and key not in but
    ]
    return ", ".join(words)
