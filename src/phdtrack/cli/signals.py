"""Signals that end a command: SIGTERM and SIGHUP do what Ctrl-C does, and a second signal ends it
at once.

Python hears of a signal when compiled code has returned. A thread hears of it at once, and ends the
process where the main thread does not move for a second and a half: in a kernel, in its
compilation, or in an encoder that waits for its file.
"""

from __future__ import annotations

import atexit
import gc
import os
import signal
import socket
import sys
import threading
import time
from _thread import interrupt_main

from phdtrack.errors import DEFERRED, INTERRUPTING, later

_ENDING = ("SIGINT", "SIGTERM", "SIGHUP")
# Signals that came, and those that have raised KeyboardInterrupt.
_came: list[int] = []
_answered: list[int] = []
_listening: list[bool] = []
# Between two looks at the main thread, seconds; looks without a move after which it hangs. They are
# counted, not timed: on a busy machine both threads are slow.
_LOOK = 0.05
_HANGS = 28
# The thread that hears of signals.
_WATCHER = "phdtrack signals"


def listen() -> None:
    """From now on SIGTERM and SIGHUP raise KeyboardInterrupt where Ctrl-C would. Those that are
    ignored stay so (nohup).
    """
    _listening.append(True)
    for number in _numbers():
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _end)
    INTERRUPTING.append(_end)
    sys.unraisablehook = _again
    ends = socket.socketpair()
    ends[1].setblocking(False)
    signal.set_wakeup_fd(ends[1].fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=ends, name=_WATCHER, daemon=True).start()


def last_chance(what: str) -> None:
    """Say what was stopped; from now on the next signal ends the process at once. Nothing where
    nobody `listen`s.
    """
    if _listening and threading.current_thread() is threading.main_thread():
        print(f"phdtrack: {what} (again: end at once)", file=sys.stderr, flush=True)
        for number in _numbers():
            if signal.getsignal(number) is _end:
                signal.signal(number, signal.SIG_DFL)


def status() -> int:
    """The exit status after a signal: 128 and its number; that of Ctrl-C where none was noted."""
    return 128 + (_came[-1] if _came else int(signal.SIGINT))


def which() -> str:
    """The name of the last signal."""
    if _came:
        return signal.Signals(_came[-1]).name
    return "Ctrl-C"


def leave(code: int) -> None:
    """End the process with an exit status, also where a thread hangs that reads a source, or still
    compiles kernels. A signal that comes now ends it at once."""
    for number in _numbers():
        if signal.getsignal(number) is _end:
            signal.signal(number, signal.SIG_DFL)
    at_work = [
        one
        for one in threading.enumerate()
        if one is not threading.main_thread() and one.name != _WATCHER
    ]
    waiting = [one for one in at_work if not one.daemon]
    # Python takes itself apart under a thread that is at work: a compiler aborts the process then.
    if not at_work and not _came:
        # Python would look for garbage in all modules once more, for half a second.
        gc.freeze()
        sys.exit(code)
    if not waiting:
        # Python would say SIGINT of whatever signal came while a text was executed, as where a
        # dataclass is made.
        atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


def _numbers() -> list[int]:
    return [int(one) for one in signal.Signals if one.name in _ENDING]


def _end(number: int, frame: object) -> None:
    """Do what Ctrl-C would do here and now: it may have to wait for compiled code."""
    _came.append(number)
    ctrl_c = signal.getsignal(signal.SIGINT)
    if callable(ctrl_c) and ctrl_c != _end:
        ctrl_c(number, None)
        return
    _answered.append(number)
    raise KeyboardInterrupt


def _again(lost: sys.UnraisableHookArgs) -> None:
    """A KeyboardInterrupt that came where Python drops what is raised, as while an object is
    deleted, comes once more.
    """
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)
        return
    timer = threading.Timer(_LOOK, _send, [_came[-1] if _came else int(signal.SIGINT)])
    timer.daemon = True
    timer.start()


def _send(number: int) -> None:
    """A signal to the main thread, which it wakes where the system can do that."""
    if sys.platform == "win32":
        interrupt_main(number)
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, number)


def _watch(told: socket.socket, _: socket.socket) -> None:
    """End the process where a signal came and the main thread hangs."""
    for count in range(1, 1000):
        number = told.recv(1)[0]
        before = 0
        still = 0
        while len(_answered) < count and (DEFERRED or signal.getsignal(number) in (_end, later)):
            time.sleep(_LOOK)
            now = _place()
            still = still + 1 if now == before else 0
            before = now
            if still >= _HANGS:
                said = (
                    f"phdtrack: {signal.Signals(number).name}, while a step did not end: .part"
                    " files hold what was done\n"
                )
                os.write(2, said.encode())
                os._exit(128 + number)


def _place() -> int:
    """The place of the main thread in the program; the same for all of a compilation."""
    top = frame = sys._current_frames().get(threading.main_thread().ident or 0)
    while frame is not None:
        if str(frame.f_globals.get("__name__")).startswith("numba.core."):
            return -1
        frame = frame.f_back
    if top is None:
        return 0
    return hash((id(top), top.f_lasti))
