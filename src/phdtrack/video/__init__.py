"""Frames in and out: video files, folders of images; H.264 that plays in a browser.

`open_source` yields frames in order with their times; `VideoWriter` writes them. PyAV (FFmpeg) and
OpenCV are imported when the first file is opened.
"""

from phdtrack.video.opening import open_source
from phdtrack.video.video_source import VideoSource
from phdtrack.video.writing import VideoWriter

__all__ = ["VideoSource", "VideoWriter", "open_source"]
