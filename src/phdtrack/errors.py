"""Errors that a user can mend.

Every message says what was expected, what came, where (file, line, frame or option) and the likely cure, in one or two
sentences. The command line prints it without a traceback and exits with status 2.
"""

from __future__ import annotations

from pathlib import Path


class InputError(ValueError):
    """The input is not what it should be, and the user can mend it.

    Parameters
    ----------
    problem : what was expected and what came.
    where : file, option or frame that the problem is in ("det.txt, line 12").
    cure : what to do about it; may be empty.
    """

    def __init__(self, problem: str, *, where: str | Path = "", cure: str = "") -> None:
        self.problem, self.where, self.cure = problem, str(where), cure
        text = f"{where}: {problem}" if where else problem
        super().__init__(f"{text.rstrip('.')}. {cure}" if cure else text)


def interrupted(error: BaseException) -> bool:
    """Whether ``error`` is Ctrl-C, or what compiled code has made of it: some of Numba's turns it into a SystemError."""
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, KeyboardInterrupt):
            return True
        seen = seen.__cause__ or seen.__context__
    return False
