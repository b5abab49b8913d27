"""Cameras between pixels and the ground: Tsai, OpenCV and homography cameras, terrain, covariances,
calibration from points.
"""

from phdtrack.ground.calibration import Calibration, fit_homography
from phdtrack.ground.camera_files import MatrixForm, read_camera
from phdtrack.ground.cameras import CountedFrom, PosedCamera, ground_covariance
from phdtrack.ground.footprint import footprint
from phdtrack.ground.homography import HomographyCamera
from phdtrack.ground.lenses import OpenCVLens, TsaiLens
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
