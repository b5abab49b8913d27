"""Signals that end a command: SIGTERM and SIGHUP do what Ctrl-C does, and a second signal ends it at once."""

from __future__ import annotations

import os
import signal
import sys
import threading

_ENDING = ("SIGINT", "SIGTERM", "SIGHUP")
_came: list[int] = []
_listening: list[bool] = []


def listen() -> None:
    """From now on SIGTERM and SIGHUP raise KeyboardInterrupt where Ctrl-C would. Those that are ignored stay so (nohup)."""
    _listening.append(True)
    for number in _numbers():
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _end if number != signal.SIGINT else signal.default_int_handler)


def last_chance(what: str) -> None:
    """Say what was stopped; from now on the next signal ends the process at once. Nothing where nobody `listen`s."""
    if _listening and threading.current_thread() is threading.main_thread():
        print(f"phdtrack: {what} (again: end at once)", file=sys.stderr, flush=True)
        for number in _numbers():
            if signal.getsignal(number) in (_end, signal.default_int_handler):
                signal.signal(number, signal.SIG_DFL)


def status() -> int:
    """The exit status after a signal: 128 and its number; that of Ctrl-C where none was noted."""
    return 128 + (_came[-1] if _came else int(signal.SIGINT))


def which() -> str:
    """What the signal is called that came last."""
    return signal.Signals(_came[-1]).name if _came else "Ctrl-C"


def leave(code: int) -> None:
    """End the process with an exit status, also where a thread hangs that reads a source."""
    waiting = [one for one in threading.enumerate() if one is not threading.main_thread() and not one.daemon]
    if not waiting:
        sys.exit(code)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


def _numbers() -> list[int]:
    return [int(one) for one in signal.Signals if one.name in _ENDING]


def _end(number: int, frame: object) -> None:
    """Do what Ctrl-C would do here and now: it may have to wait for compiled code."""
    _came.append(number)
    ctrl_c = signal.getsignal(signal.SIGINT)
    if callable(ctrl_c):
        ctrl_c(signal.SIGINT, None)
        return
    raise KeyboardInterrupt
