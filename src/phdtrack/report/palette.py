"""Colours of identities, shared by the annotated video and the plots, so that object 7 looks the same everywhere.

Twelve colours, light enough for dark pictures and strong enough for white paper. They are ordered so that identities
with consecutive numbers, which often stand side by side, differ clearly: at least 40 units of CIE L*a*b* apart for normal
sight and in the simulation of protanopia and deuteranopia by Machado, Oliveira and Fernandes (2009). Twelve colours repeat;
wherever an identity is drawn its number stands beside it, so that colour is never the only sign.
"""

from __future__ import annotations

Rgb = tuple[int, int, int]

COLOURS: tuple[Rgb, ...] = (
    (0xFF, 0x9F, 0x1C),
    (0x1F, 0xB5, 0xAD),
    (0xFF, 0xE1, 0x4D),
    (0xA7, 0x8B, 0xFA),
    (0x2E, 0xC2, 0x7E),
    (0x4D, 0x7C, 0xFE),
    (0xFF, 0x4D, 0x4D),
    (0xE8, 0xD5, 0xFF),
    (0xC9, 0x8B, 0x5B),
    (0x4C, 0xC9, 0xF0),
    (0xB5, 0xE8, 0x53),
    (0xFF, 0x7A, 0xC6),
)

BLACK: Rgb = (0, 0, 0)
WHITE: Rgb = (255, 255, 255)


def identity_colour(identity: int) -> Rgb:
    """Red, green, blue (0–255) of the object with this identity (from 1)."""
    return COLOURS[(identity - 1) % len(COLOURS)]


def hexadecimal(colour: Rgb) -> str:
    """The colour as ``#rrggbb``, for CSS and matplotlib."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def ink_on(colour: Rgb) -> Rgb:
    """Black or white, whichever is easier to read on ``colour`` (by relative luminance)."""
    red, green, blue = ((c / 255) ** 2.2 for c in colour)
    return BLACK if 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.2 else WHITE
