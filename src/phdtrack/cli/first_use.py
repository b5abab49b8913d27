"""One line while kernels are compiled, so that the first run does not look as if it hung."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from phdtrack.cli.compiling import Compiled, watched
from phdtrack.cli.output import Output
from phdtrack.cli.precompile import precompile
from phdtrack.kernels import CACHE

FIRST = "compiling kernels (first use on this machine, ten seconds to half a minute; they are kept for the next runs) ..."
ALWAYS = (
    "kernels are compiled anew in every run (ten seconds to half a minute): neither the installation nor the home folder "
    "can be written into; set NUMBA_CACHE_DIR to a folder that can"
)


@contextmanager
def announced(out: Output, filter_name: str) -> Iterator[Compiled]:
    """While this lasts, say so when the first kernel is compiled, and nothing where all come from disk.

    What a run with this filter will need is compiled first, by all cores.

    On a terminal only, as a progress bar is; what a user can mend is said in any case.
    """

    def begun() -> None:
        if not CACHE.lasting:
            out.warn(ALWAYS)
        elif sys.stderr.isatty():
            out.note(FIRST)

    with watched(begun) as compiled:
        precompile(filter_name)
        yield compiled
