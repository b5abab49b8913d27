"""Frames in and out: video files, folders of images; H.264 that plays in a browser.

`open_source` gives frames in order, with the time at which each was taken; `VideoWriter` writes
them. PyAV (FFmpeg) and OpenCV are imported when the first file is opened.
"""

from phdtrack.video.reading import VideoSource, open_source
from phdtrack.video.writing import VideoWriter

__all__ = ["VideoSource", "VideoWriter", "open_source"]
