"""Settings written as TOML, for the tests of configuration."""

from __future__ import annotations

from pathlib import Path


def toml(value) -> str:
    """A value as TOML writes it."""
    match value:
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case list() | tuple():
            return "[" + ", ".join(toml(item) for item in value) + "]"
        case _:
            return repr(value)


def written(path: Path, settings: dict[str, object]) -> Path:
    """A TOML file of `Settings.as_dict`."""
    lines = [f"preset = {toml(settings['preset'])}"]
    for name, values in settings.items():
        if isinstance(values, dict):
            lines += [f"[{name}]", *(f"{key} = {toml(value)}" for key, value in values.items())]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path
