"""Between pixels and the ground: Tsai, OpenCV and homography cameras, terrain, covariances,
calibration from points.
"""

from phdtrack.ground.camera_files import Calibration, MatrixForm, fit_homography, read_camera
from phdtrack.ground.cameras import (
    CountedFrom,
    HomographyCamera,
    OpenCVLens,
    PosedCamera,
    TsaiLens,
    footprint,
    ground_covariance,
)
from phdtrack.ground.terrain import Flat, Surface, Terrain, read_terrain

__all__ = [
    "Calibration",
    "CountedFrom",
    "Flat",
    "HomographyCamera",
    "MatrixForm",
    "OpenCVLens",
    "PosedCamera",
    "Surface",
    "Terrain",
    "TsaiLens",
    "fit_homography",
    "footprint",
    "ground_covariance",
    "read_camera",
    "read_terrain",
]
