"""Between pixels and the ground: Tsai, OpenCV and homography cameras, terrain, covariances, calibration from points."""

from phdtrack.ground.calibrate import Calibration, fit_homography
from phdtrack.ground.counted import CountedFrom
from phdtrack.ground.covariance import ground_covariance, ground_gaussian
from phdtrack.ground.footprint import footprint
from phdtrack.ground.homography import HomographyCamera
from phdtrack.ground.matrices import MatrixForm
from phdtrack.ground.pinhole import OpenCVLens
from phdtrack.ground.posed import Lens, PosedCamera
from phdtrack.ground.read import read_camera
from phdtrack.ground.terrain import Flat, Surface, Terrain
from phdtrack.ground.terrain_files import read_terrain
from phdtrack.ground.tsai import TsaiLens

__all__ = [
    "Calibration",
    "CountedFrom",
    "Flat",
    "HomographyCamera",
    "Lens",
    "MatrixForm",
    "OpenCVLens",
    "PosedCamera",
    "Surface",
    "Terrain",
    "TsaiLens",
    "fit_homography",
    "footprint",
    "ground_covariance",
    "ground_gaussian",
    "read_camera",
    "read_terrain",
]
