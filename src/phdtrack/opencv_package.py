"""OpenCV of whichever package is installed, loaded when its first function is called.

Four packages bring `cv2` (opencv-python, opencv-contrib-python, and both as -headless), and each
overwrites the files of the others. phdtrack requires none, so that installing it never replaces
the one that is there; what needs OpenCV imports `cv2` from here.
"""

from __future__ import annotations

from typing import Any

from phdtrack.errors import InputError, absent

# A wheel with windows needs libraries of the desktop, which servers and containers lack.
_HEADLESS = "python -m pip install --force-reinstall opencv-python-headless"


class _OpenCV:
    """Stands for the module `cv2`, which is loaded when one of its names is first asked for."""

    def __getattr__(self, name: str) -> Any:
        # Whoever looks at this object, as a debugger does, loads nothing.
        if name.startswith("__") and name != "__version__":
            raise AttributeError(name)
        try:
            import cv2
        except ModuleNotFoundError as error:
            if error.name != "cv2":
                raise
            raise absent(error) from None
        except ImportError as error:
            raise InputError(
                f"OpenCV is installed, but cannot be loaded: {error}",
                cure=f"On a machine without a desktop: {_HEADLESS}",
            ) from None
        value = getattr(cv2, name)
        # The next time it is found at once: pictures are drawn with many short calls.
        setattr(self, name, value)
        return value


cv2: Any = _OpenCV()
"""`cv2`. Its names raise `InputError` with the line that installs or mends it where it cannot be
loaded."""
