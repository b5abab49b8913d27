"""``phdtrack warm-up``: the kernels, compiled before the first run."""

from __future__ import annotations

import time
from pathlib import Path

from phdtrack.cli import options as given
from phdtrack.cli.output import Output, counted
from phdtrack.errors import InputError
from phdtrack.kernels.cache import kept_in
from phdtrack.run.requests import TrackingRequest
from phdtrack.run.warming import warming_steps


def warm_up(
    output: Output,
    filter_name: given.Filter = "",
    preset: given.Preset = "",
    config: given.Config = None,
    sets: given.Sets = None,
) -> None:
    """Compile the kernels in advance, for example while a Docker image is built.

    Kernels that are kept already are only loaded. They are kept for the processor of this machine
    and the version of phdtrack: in the folder NUMBA_CACHE_DIR, beside the installation, or in the
    home folder, whichever can be written into first. Options choose the settings to compile for, as
    in `phdtrack track`; groups, and other filters, compile what more they need when they first run.
    """
    folder = kept_in()
    if folder is None:
        problem = (
            "kernels would not be kept: neither the installation nor the home folder can be written"
            " into, or NUMBA_DISABLE_JIT is set"
        )
        raise InputError(problem, cure="Set NUMBA_CACHE_DIR to a folder that can.")
    before = _kernels(folder)
    began = time.perf_counter()
    left_out = list[str]()
    steps = warming_steps(TrackingRequest(filter_name, preset, config, sets))
    for number, (title, work) in enumerate(steps, start=1):
        if not output.quiet:
            output.note(f"{number} of {len(steps)}: {title} ...")
        try:
            work()
        except InputError as error:
            left_out.append(f"left out: {title}: {error}")
    seconds = time.perf_counter() - began
    compiled = _kernels(folder) - before
    output.warn(left_out)
    work_done = f"{counted(compiled, 'kernel')} compiled" if compiled else "All kernels were kept"
    output.say(f"{work_done}, in {seconds:.1f} s: {folder}")
    output.document(
        {
            "compiled": compiled,
            "kept": before + compiled,
            "seconds": seconds,
            "folder": str(folder),
            "left_out": left_out,
        }
    )


def _kernels(folder: Path) -> int:
    """The number of kernels, in all forms, that a folder keeps."""
    return sum(1 for _ in folder.glob("*.nbc"))
