"""How the camera moves from frame to frame: measured in the pictures, or read from a file. See `camera.warp` for its use."""

from phdtrack.video.ego_motion.flow import CameraMotion, Flow
from phdtrack.video.ego_motion.path import CameraPath
from phdtrack.video.ego_motion.settings import GivenWarps, SparseFlow, Standing

__all__ = ["CameraMotion", "CameraPath", "Flow", "GivenWarps", "SparseFlow", "Standing"]
