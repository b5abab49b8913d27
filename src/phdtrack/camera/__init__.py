"""Between pixels and the ground: Tsai, OpenCV and homography cameras, terrain, covariances, calibration from points."""

from phdtrack.camera.calibrate import Calibration, fit_homography
from phdtrack.camera.counted import CountedFrom
from phdtrack.camera.covariance import ground_covariance, ground_gaussian
from phdtrack.camera.footprint import footprint
from phdtrack.camera.homography import HomographyCamera
from phdtrack.camera.matrices import MatrixForm
from phdtrack.camera.pinhole import OpenCVLens
from phdtrack.camera.posed import Lens, PosedCamera
from phdtrack.camera.read import read_camera
from phdtrack.camera.terrain import Flat, Surface, Terrain
from phdtrack.camera.terrain_files import read_terrain
from phdtrack.camera.tsai import TsaiLens

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
