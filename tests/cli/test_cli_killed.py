"""Runs that are killed, stopped, or cannot write: what is there is whole, and a resumed run writes
the same files.
"""

from __future__ import annotations

import json
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, refused

from phdtrack.files import part_of
from phdtrack.run import directory as rundir
from phdtrack.run.detection_log import write_block
from phdtrack.state import blocks, from_bytes, to_bytes
from phdtrack.video import VideoWriter, open_source

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("paged")]

SAME = (rundir.TRACKS, rundir.ONLINE, rundir.STATES, rundir.DETECTIONS, rundir.VIDEO)
# Ends its own process by a signal after some calls of a method.
KILLED = """
import os, signal, sys
from phdtrack.cli.app import main
from {module} import {kind}
real, calls = {kind}.{method}, []
def counted(*given, **more):
    calls.append(1)
    if len(calls) == {after}:
        os.kill(os.getpid(), signal.{name})
    return real(*given, **more)
{kind}.{method} = counted
sys.argv = ["phdtrack", *{words}]
main()
"""


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video of 60 frames in which a dark box crosses a noisy grey."""
    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    rng = np.random.default_rng(5)
    ground = rng.integers(120, 136, (96, 160, 3))
    with VideoWriter(path, 160, 96, 25.0) as writer:
        for k in range(60):
            image = (ground + rng.integers(-2, 3, ground.shape)).astype(np.uint8)
            image[30:70, 10 + 2 * k : 26 + 2 * k] = 30
            writer.write(image)
    return path


def given(clip: Path, out: Path, *more: str) -> list[str]:
    return [
        "track",
        str(clip),
        "--out",
        str(out),
        "--checkpoint-every",
        "0.001",
        "--fps",
        "25",
        *more,
    ]


@pytest.fixture(scope="module")
def whole(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run that nothing stopped."""
    out = tmp_path_factory.mktemp("whole") / "run"
    assert phdtrack(*given(clip, out)).status == 0
    assert (
        sorted(path.name for path in out.iterdir() if path.suffix in (".part", ".log", ".detector"))
        == []
    )
    return out


def ended(
    words: list[str], at: tuple[str, str, str, int], name: str, limit: int = 0
) -> subprocess.CompletedProcess[str]:
    """A run in a process of its own that a signal comes to, in a call of ``module``'s
    ``kind.method``.
    """
    module, kind, method, after = at
    code = KILLED.format(
        module=module, kind=kind, method=method, after=after, name=name, words=words
    )

    def bounded() -> None:
        if limit:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=600,
        preexec_fn=bounded,
    )


NEVER = ("phdtrack.formats", "StatesWriter", "append", 10**9)


def same(out: Path, whole: Path) -> None:
    """All files are those of the run that nothing stopped, and nothing else is left."""
    assert {path.name for path in out.iterdir()} == {path.name for path in whole.iterdir()}
    for name in SAME:
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name
    document, usual = (json.loads((folder / rundir.RUN).read_text()) for folder in (out, whole))
    assert document["complete"] is True
    for key in ("frames", "tracks", "configuration", "summary"):
        if key in usual and key != "summary":
            assert document[key] == usual[key], key


@pytest.mark.parametrize(
    "at",
    [
        ("phdtrack.formats", "StatesWriter", "append", 1),
        ("phdtrack.formats", "StatesWriter", "append", 40),
        ("phdtrack.video", "VideoWriter", "write", 30),
    ],
    ids=["first frame", "tracking", "drawing"],
)
def test_a_killed_run_is_resumed_and_writes_the_same(
    at: tuple[str, str, str, int], clip: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    assert ended(given(clip, out), at, "SIGKILL").returncode == -signal.SIGKILL
    # Nothing has a name that says that it is complete, but what is.
    for path in (path for path in out.iterdir() if path.name in rundir.RUN_FILES):
        assert path.read_bytes() == (whole / path.name).read_bytes()
    assert "--resume" in refused(*given(clip, out))
    said = phdtrack(*given(clip, out, "--resume"))
    assert said.status == 0, said.err
    same(out, whole)
    assert "nothing to resume" in phdtrack(*given(clip, out, "--resume")).out


@pytest.mark.parametrize(
    ("name", "status"),
    [
        ("SIGTERM", 143),
        pytest.param("SIGHUP", 129, marks=pytest.mark.slow),
        pytest.param("SIGINT", 130, marks=pytest.mark.slow),
    ],
)
def test_a_signal_finishes_what_was_done_and_the_rest_can_follow(
    name: str, status: int, clip: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    done = ended(
        given(clip, out, "--checkpoint-every", "60"),
        ("phdtrack.formats", "StatesWriter", "append", 40),
        name,
    )
    assert done.returncode == status, done.stderr
    assert "stopped after frame 40" in done.stderr
    document = json.loads((out / rundir.RUN).read_text())
    assert (document["complete"], document["frames"]) == (False, 40)
    assert not list(out.glob("*.part"))
    assert len(list(open_source(out / rundir.VIDEO))) == 40
    said = phdtrack(*given(clip, out, "--resume", "--json"))
    assert said.object["resumed_from_frame"] >= 40
    same(out, whole)


def test_the_status_is_that_of_the_signal(tmp_path: Path) -> None:
    """After an interrupt in a text that is executed, Python ends a module that is run with the
    status of SIGINT.
    """
    (tmp_path / "ended.py").write_text(
        "import os, signal\n"
        "from phdtrack.cli import signals\n"
        "signals.listen()\n"
        "try:\n"
        "    exec('os.kill(os.getpid(), signal.SIGTERM)\\nwhile True: pass')\n"
        "except KeyboardInterrupt:\n"
        "    signals.leave(signals.status())\n"
    )
    done = subprocess.run([sys.executable, "-m", "ended"], cwd=tmp_path, check=False)
    assert done.returncode == 143


def test_the_status_is_that_of_a_signal_while_options_are_read() -> None:
    code = (
        "import os, signal, sys\n"
        "from phdtrack.cli import app\n"
        "from typer import core\n"
        "core.TyperCommand.parse_args = lambda *_: os.kill(os.getpid(), signal.SIGTERM)\n"
        "sys.argv = ['phdtrack', 'track', 'a.mp4']\n"
        "app.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.strip().splitlines()[-1]) == (143, "phdtrack: stopped")


def test_a_signal_is_not_lost_where_python_drops_what_is_raised() -> None:
    """As while an object is deleted, or in the callback of a weak reference."""
    code = (
        "import signal, time\n"
        "from phdtrack.cli import signals\n"
        "class Gone:\n"
        "    def __del__(self):\n"
        "        signal.raise_signal(signal.SIGTERM)\n"
        "signals.listen()\n"
        "try:\n"
        "    Gone()\n"
        "    time.sleep(60)\n"
        "except KeyboardInterrupt:\n"
        "    signals.leave(signals.status())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False
    )
    assert (done.returncode, done.stderr) == (143, "")


def left_by(code: str, file: Path) -> str:
    """What a program, which is given its name, has written into a file. It must end with status 3
    and say what its exit function says.
    """
    command = [sys.executable, "-c", code, str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (3, "exit function\n", "")
    return file.read_text()


def test_a_command_ends_with_exit_functions_and_files_closed(tmp_path: Path) -> None:
    """Garbage is not looked for any more, but whatever is to be done at the end is done."""
    code = (
        "import atexit, sys\n"
        "from phdtrack.cli import signals\n"
        "atexit.register(print, 'exit function')\n"
        "file = open(sys.argv[1], 'w')\n"
        "file.write('not flushed')\n"
        "signals.listen()\n"
        "signals.leave(3)\n"
    )
    assert left_by(code, tmp_path / "file.txt") == "not flushed"


@pytest.mark.parametrize("at_work", [False, True])
def test_python_is_not_taken_apart_under_a_thread_at_work(tmp_path: Path, at_work: bool) -> None:
    """A compiler in such a thread would abort the process. Commands close their files themselves;
    one that is left open shows whether Python took itself apart.
    """
    code = (
        "import atexit, sys, threading, time\n"
        "from phdtrack.cli import signals\n"
        "atexit.register(print, 'exit function')\n"
        "file = open(sys.argv[1], 'w')\n"
        "file.write('left open')\n"
        "signals.listen()\n"
        f"if {at_work}:\n"
        "    threading.Thread(target=time.sleep, args=(60,), daemon=True).start()\n"
        "signals.leave(3)\n"
    )
    assert left_by(code, tmp_path / "file.txt") == ("" if at_work else "left open")


def test_an_early_signal_ends_the_command() -> None:
    done = ended(["settings"], ("threading", "Thread", "start", 1), "SIGTERM")
    assert (done.returncode, done.stderr.strip()) == (143, "phdtrack: stopped")


def test_a_second_signal_ends_at_once(clip: Path, tmp_path: Path) -> None:
    """It comes while the video is drawn, after the first one in the loop: nothing is finished any
    more.
    """
    words = given(clip, tmp_path / "run")
    code = KILLED.format(
        module="phdtrack.formats",
        kind="StatesWriter",
        method="append",
        after=9,
        name="SIGTERM",
        words=words,
    )
    code = code.replace(
        "main()",
        "import time\n"
        "from phdtrack.run import video\n"
        "video.draw_videos = lambda *a: time.sleep(600)\n"
        "main()",
    )
    with subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True) as child:
        assert child.stderr is not None
        assert "again: end at once" in next(line for line in child.stderr if "stopped" in line)
        time.sleep(0.2)
        begun = time.monotonic()
        child.send_signal(signal.SIGTERM)
        assert child.wait(300) == -signal.SIGTERM
        assert time.monotonic() - begun < 60


# In the place of a method: a kernel that does not end, one that is compiled for ever, and FFmpeg
# that writes into a pipe that nobody reads. None of them lets Python's own handlers run.
HANGING = {
    "kernel": """
import numba
@numba.njit(nogil=True)
def spin(n):
    while n != 0:
        n = n % 1000 + 1
    return n
spin.compile((numba.types.int64,))
hang = lambda: spin(1)
""",
    "compilation": """
import numba.core.dispatcher as dispatcher
code = compile("def hang():\\n while True: pass", "x", "exec")
exec(code, dispatcher.__dict__)
hang = dispatcher.hang
""",
    "encoder": """
import av, numpy as np
def hang():
    os.mkfifo({pipe!r})
    reader = os.open({pipe!r}, os.O_RDONLY | os.O_NONBLOCK)
    with av.open({pipe!r}, "w", format="mpegts") as container:
        stream = container.add_stream("mpeg2video", rate=25)
        stream.width, stream.height, stream.pix_fmt = 640, 480, "yuv420p"
        while True:
            noise = np.random.default_rng(1).integers(0, 255, (480, 640, 3), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(noise, format="bgr24")))
""",
}


@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("kernel", "SIGINT"),
        pytest.param("compilation", "SIGTERM", marks=pytest.mark.slow),
        pytest.param("encoder", "SIGHUP", marks=pytest.mark.slow),
    ],
)
def test_a_signal_ends_a_run_that_hangs(what: str, name: str, clip: Path, tmp_path: Path) -> None:
    """And says so; nothing has a name that says that it is complete."""
    out = tmp_path / "run"
    number = getattr(signal, name)
    code = KILLED.format(
        module="phdtrack.formats",
        kind="StatesWriter",
        method="append",
        after=9,
        name="SIGCONT",
        words=given(clip, out),
    )
    code = code.replace("os.kill(os.getpid(), signal.SIGCONT)", "print('here', flush=True), hang()")
    code = HANGING[what].format(pipe=str(tmp_path / "pipe")) + code
    with subprocess.Popen(
        [sys.executable, "-c", "import os\n" + code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as child:
        assert child.stdout is not None
        assert "here" in child.stdout.readline()
        time.sleep(1.0)
        begun = time.monotonic()
        child.send_signal(number)
        _, errors = child.communicate(timeout=120)
        took = time.monotonic() - begun
    assert child.returncode == 128 + number, errors
    assert f"{name}, while a step did not end" in errors
    # Two seconds are asked for; what hangs would do so for ever.
    assert took < 60
    assert not [path.name for path in out.iterdir() if path.name in (*SAME, rundir.RUN)]


@pytest.mark.parametrize(
    ("limit", "lost"),
    [
        pytest.param(3_000, rundir.STATES, marks=pytest.mark.slow),
        (8_000, rundir.VIDEO),
        pytest.param(60_000, rundir.REPORT, marks=pytest.mark.slow),
    ],
)
def test_a_full_disk_leaves_no_cut_file_and_is_said(
    limit: int, lost: str, clip: Path, whole: Path, tmp_path: Path
) -> None:
    """A file cannot grow beyond a limit, which hits one after the other."""
    out = tmp_path / "run"
    sizes = {
        name: (whole / name).stat().st_size for name in (rundir.STATES, rundir.VIDEO, rundir.REPORT)
    }
    assert sizes[lost] > limit, sizes
    done = ended(given(clip, out), NEVER, "SIGKILL", limit)
    assert done.returncode == 2, done.stderr
    assert f"{lost}: the file cannot be written: File too large" in done.stderr
    assert "Traceback" not in done.stderr
    for path in (
        path
        for path in out.iterdir()
        if path.name in rundir.RUN_FILES and path.name not in (rundir.RUN, lost)
    ):
        text = path.read_bytes()
        assert path.suffix != ".csv" or text.endswith(b"\n") or not text
        assert path.suffix != ".html" or text.rstrip().endswith(b"</html>")
    assert not (out / lost).exists()
    assert phdtrack(*given(clip, out, "--resume")).status == 0
    same(out, whole)


def test_a_folder_that_is_gone_is_no_success(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from phdtrack.run import video

    real = video.draw_videos
    out = tmp_path / "run"

    def removed(*arguments: object) -> None:
        shutil.rmtree(out)
        real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(video, "draw_videos", removed)
    said = phdtrack(*given(clip, out))
    assert said.status == 2
    assert "Was the folder removed meanwhile?" in said.err


def test_two_runs_do_not_write_into_one_folder(clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = given(clip, out)
    code = KILLED.format(
        module="phdtrack.formats",
        kind="StatesWriter",
        method="append",
        after=3,
        name="SIGSTOP",
        words=words,
    )
    with subprocess.Popen([sys.executable, "-c", code]) as child:
        os.waitid(os.P_PID, child.pid, os.WSTOPPED)
        said = refused(*given(clip, out, "--overwrite"))
        assert "another run is writing into this directory" in said
        child.kill()
    assert phdtrack(*given(clip, out, "--overwrite")).status == 0


def test_a_complete_run_is_not_gone_on_with(clip: Path, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = ["track", str(clip), "--fps", "25"]
    before = {file.name: file.read_bytes() for file in shutil.copytree(whole, out).iterdir()}
    said = phdtrack(*given(clip, out, "--resume"))
    assert (said.status, "nothing to resume" in said.out) == (0, True)
    assert "differs in seed" in refused(*given(clip, out, "--resume", "--seed", "3"))
    assert "and differs in " in refused(*given(clip, out, "--resume", "--filter", "gm-phd"))
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before
    said = phdtrack(*words, "--out", tmp_path / "new", "--resume", "--no-video")
    assert (said.status, "There is no checkpoint" in said.err) == (0, True)
    # Killed while it drew: the detections are there.
    (tmp_path / "new" / rundir.RUN).unlink()
    said = phdtrack(*words, "--out", tmp_path / "new", "--resume", "--no-video")
    assert (said.status, "There is no checkpoint" in said.err) == (0, False)


def test_a_checkpoint_of_another_run_is_refused(clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    ended(given(clip, out), ("phdtrack.formats", "StatesWriter", "append", 50), "SIGKILL")
    assert "differs in: seed" in refused(*given(clip, out, "--resume", "--seed", "3"))
    assert "of a run that differs in: settings" in refused(
        *given(clip, out, "--resume", "--filter", "gm-phd")
    )

    def other(**more: object) -> Callable[[bytes], bytes]:
        return lambda held: zlib.compress(to_bytes({**from_bytes(zlib.decompress(held)), **more}))

    knew = from_bytes(zlib.decompress((out / rundir.KNOWN).read_bytes()))["detector"]
    number = next(name for name, value in knew.items() if isinstance(value, float))
    damaged = (
        {"key": "{"},
        {"key": "[1]"},
        {"key": np.zeros(3)},
        {"number": math.inf},
        {"size": []},
    )
    for change, words in (
        (lambda held: held[: len(held) // 2], "no checkpoint can be read"),
        (lambda held: zlib.compress(to_bytes(np.ones(3))), "no checkpoint can be read"),
        *((other(**more), "no checkpoint can be read") for more in damaged),
        (other(format=np.ones(3)), "of another version"),
        (other(number=2), "does not fit|ends before"),
        (other(detector={}), "of another detector"),
        (other(detector=knew | {number: 1e300}), "of another detector"),
    ):
        held = (out / rundir.KNOWN).read_bytes()
        (out / rundir.KNOWN).write_bytes(change(held))
        said = phdtrack(*given(clip, out, "--resume"))
        assert said.status == 2
        assert any(word in said.err for word in words.split("|")), said.err
        (out / rundir.KNOWN).write_bytes(held)
    with (out / rundir.LOG).open("rb") as log:
        assert [value.get("number") for _, value in blocks(log)][:4] == [None, 1, 2, 3]
    (out / rundir.LOG).write_bytes(2 * to_bytes(np.ones(3)))
    assert "does not fit the source" in phdtrack(*given(clip, out, "--resume")).err


def test_nothing_that_grows_is_read(clip: Path, tmp_path: Path) -> None:
    for name, words in (("clip.mp4", ["track"]), ("tracks.csv", ["track", "--detections"])):
        grown = part_of(tmp_path / name)
        shutil.copy(clip, grown)
        assert "this file is not complete" in refused(
            *words, str(grown), "--out", str(tmp_path / "run")
        )


def test_a_partial_write_is_continued() -> None:
    class Nearly:
        """A file on a disk that takes a few bytes at once."""

        taken = b""

        def write(self, content: memoryview) -> int:
            self.taken += bytes(content[:7])
            return min(7, len(content))

    file = Nearly()
    block = {"looked": "at all", "array": np.arange(9)}
    write_block(file, block)  # type: ignore[arg-type]
    assert file.taken == to_bytes(block)
