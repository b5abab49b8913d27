"""What holds only while the camera stands still: densities of births and false alarms that lie at pixels of the image."""

from __future__ import annotations

from phdtrack.errors import InputError
from phdtrack.models.births import FixedBirth
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.protocols import Model


def not_standing(what: str) -> InputError:
    """The error of a part that lies at pixels, under a camera that moves."""
    return InputError(
        f"{what} holds for places in the image of a camera that stands still",
        where="camera motion",
        cure="Leave it out, or do not compensate the camera's motion",
    )


def refuse_standing(model: Model) -> None:
    """Raise `InputError` where births or false alarms of the model lie at pixels, which a moving camera leaves behind."""
    if isinstance(model.birth, FixedBirth | SceneBirth):
        raise not_standing("where targets appear (birth.kind=fixed or scene)")
    if isinstance(model.clutter, SceneClutter):
        raise not_standing("where false alarms are (clutter.kind=scene)")
