"""Readers and writers of detections, truth, tracks and states: MOTChallenge, KITTI, CSV, Parquet,
JSON lines, COCO, CVAT, CVML, UA-DETRAC.
"""

from phdtrack.conventions import Conventions
from phdtrack.formats.exports import EXPORTS, export_tracks
from phdtrack.formats.read import read_detections, read_tracks, read_tracks_named
from phdtrack.formats.seqinfo import find_seqinfo, read_seqinfo
from phdtrack.formats.truth import ignoring, read_truth, read_truth_by_class
from phdtrack.formats.warp_files import Warps, WarpsWriter, read_warps
from phdtrack.formats.write import (
    DetectionsWriter,
    StatesWriter,
    TracksWriter,
    write_detections,
    write_tracks,
    write_truth,
)

__all__ = [
    "EXPORTS",
    "Conventions",
    "DetectionsWriter",
    "StatesWriter",
    "TracksWriter",
    "Warps",
    "WarpsWriter",
    "export_tracks",
    "find_seqinfo",
    "ignoring",
    "read_detections",
    "read_seqinfo",
    "read_tracks",
    "read_tracks_named",
    "read_truth",
    "read_truth_by_class",
    "read_warps",
    "write_detections",
    "write_tracks",
    "write_truth",
]
