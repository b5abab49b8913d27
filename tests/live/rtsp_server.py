"""An RTSP server of GStreamer's, for tests: `/usr/bin/python3 rtsp_server.py PORT WIDTH HEIGHT
RATE`, for Debian's packages gir1.2-gst-rtsp-server-1.0, python3-gi and
gstreamer1.0-plugins-{base,good,ugly}.

It says READY, and serves rtsp://127.0.0.1:PORT/stream: H.264 of a white square that goes to and fro
by the clock (`at`). Lines on stdin change it: ``rate 5``, ``size 320 240``, ``freeze``, ``thaw``.
Status 3 where a package is missing.
"""

import sys
import threading
import time

try:
    import gi

    gi.require_version("Gst", "1.0")
    gi.require_version("GstRtspServer", "1.0")
    from gi.repository import GLib, Gst, GstRtspServer
except (ImportError, ValueError) as error:
    print(error, file=sys.stderr)
    sys.exit(3)

PIPELINE = (
    "( appsrc name=pictures is-live=true do-timestamp=true format=time max-bytes=2000000 !"
    " videoconvert ! video/x-raw,format=I420 ! x264enc tune=zerolatency speed-preset=ultrafast"
    " key-int-max=50 ! rtph264pay name=pay0 pt=96 config-interval=1 )"
)


def at(wall: float, width: int, side: int) -> int:
    """The left edge of the square: over the whole width in 8 s, and back."""
    return round(abs(wall % 16 - 8) / 8 * (width - side))


class Pictures:
    """What is served."""

    def __init__(self, width: int, height: int, rate: float) -> None:
        self.width = width
        self.height = height
        self.rate = rate
        self.frozen = False
        self.media: list[object] = []

    def made(self) -> bytes:
        """A grey picture."""
        side = self.height // 6
        left = at(time.time(), self.width, side)
        dark = bytes([30]) * self.width
        bright = bytes([30]) * left + bytes([255]) * side + bytes([30]) * (self.width - side - left)
        top = self.height // 2
        return dark * top + bright * side + dark * (self.height - top - side)

    def run(self) -> None:
        """Give a picture to each medium, again and again."""
        known: dict[object, tuple[int, int]] = {}
        while True:
            time.sleep(1 / self.rate)
            if self.frozen:
                continue
            size = (self.width, self.height)
            data = self.made()
            for source in list(self.media):
                if known.get(source) != size:
                    known[source] = size
                    caps = (
                        f"video/x-raw,format=GRAY8,width={size[0]},height={size[1]},framerate=0/1"
                    )
                    source.set_property("caps", Gst.Caps.from_string(caps))
                if source.emit("push-buffer", Gst.Buffer.new_wrapped(data)) != Gst.FlowReturn.OK:
                    self.media.remove(source)

    def obey(self) -> None:
        """Read commands."""
        for line in sys.stdin:
            word, *numbers = line.split()
            if word == "rate":
                self.rate = float(numbers[0])
            elif word == "size":
                self.width, self.height = map(int, numbers)
            else:
                self.frozen = word == "freeze"


def main() -> None:
    port, width, height, rate = sys.argv[1:]
    Gst.init(None)
    if not all(
        Gst.ElementFactory.find(name)
        for name in ("appsrc", "videoconvert", "x264enc", "rtph264pay")
    ):
        print("an element of GStreamer is missing", file=sys.stderr)
        sys.exit(3)
    pictures = Pictures(int(width), int(height), float(rate))
    server = GstRtspServer.RTSPServer()
    factory = GstRtspServer.RTSPMediaFactory()
    factory.set_launch(PIPELINE)
    factory.set_shared(True)
    factory.connect(
        "media-configure",
        lambda _, media: pictures.media.append(media.get_element().get_by_name("pictures")),
    )
    server.set_address("127.0.0.1")
    server.set_service(port)
    server.get_mount_points().add_factory("/stream", factory)
    if not server.attach(None):
        sys.exit("the port is taken")
    for work in (pictures.run, pictures.obey):
        threading.Thread(target=work, daemon=True).start()
    print("READY", flush=True)
    GLib.MainLoop().run()


if __name__ == "__main__":
    main()
