"""Frames in and out: video files, folders of images, cameras; H.264 that plays in a browser.

`open_source` gives the frames of whatever its argument names, one at a time, in order, with the time at which each was
taken; `VideoWriter` takes frames and writes a file. Decoding and encoding are PyAV's (FFmpeg); images are OpenCV's.
Both are imported when the first file is opened, so that importing this package costs nothing.

Numbers and times, for every kind of source:

* A frame's number counts from 1. In a video it counts decoded frames; headers, often wrong, are not used. In a
  folder of images it follows the numbers in the names, so that a missing file is a missing frame.
* A frame's time is in seconds since the first frame. In a video it is what the stream says (a variable rate and dropped
  frames give the true intervals); where the stream says nothing, or goes back, one frame interval is added to the last.
"""

from phdtrack.video.sources import VideoSource, open_source
from phdtrack.video.writer import VideoWriter

__all__ = ["VideoSource", "VideoWriter", "open_source"]
