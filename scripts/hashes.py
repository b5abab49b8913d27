"""Fill in the hashes of a constraints file: ``python scripts/hashes.py constraints.txt``.

Each line ``name==version`` gets a ``--hash=sha256:…`` for the source archive and for every wheel
that CPython 3.11 or later can install on Linux (glibc; x86-64, ARM), macOS and Windows. Run it
again after you change a version by hand. Hashes come from the index that this machine's pip is
configured with, through pip's own session. No address is stored.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from pip._internal.commands import create_command
from pip._internal.index.collector import LinkCollector, parse_links
from pip._internal.models.link import Link
from pip._vendor.packaging.utils import (
    canonicalize_name,
    parse_sdist_filename,
    parse_wheel_filename,
)
from pip._vendor.packaging.version import Version

OLDEST = 11
PLATFORM = re.compile(r"any|(many)?linux.*_(x86_64|aarch64)|macosx_.*|win_(amd64|arm64)")
INTERPRETER = re.compile(r"(?:py2|py3|cp3)(\d*)")


def wanted(file: str, version: Version) -> bool:
    """Return true for the source archive of this version and for wheels to install."""
    try:
        if not file.endswith(".whl"):
            return parse_sdist_filename(file)[1] == version
        _, found, _, tags = parse_wheel_filename(file)
    except ValueError:
        return False
    for tag in tags:
        match = INTERPRETER.fullmatch(tag.interpreter)
        if (
            found != version
            or not match
            or tag.interpreter.startswith("py2")
            or not PLATFORM.fullmatch(tag.platform)
        ):
            continue
        exact = tag.interpreter.startswith("cp") and tag.abi not in ("abi3", "none")
        if not exact or (int(match[1]) >= OLDEST and not tag.abi.endswith("t")):
            return True
    return False


def links(collector: LinkCollector, name: str) -> Iterator[Link]:
    """Yield the files that the index lists under this name, without indexes on local disks."""
    for source in collector.collect_sources(name, lambda _: None).index_urls:
        if source is None or source.link is None or source.link.scheme == "file":
            continue
        page = collector.fetch_response(source.link)
        yield from () if page is None else parse_links(page)


def main(paths: list[str]) -> None:
    command = create_command("download")
    options, _ = command.parse_args(["nothing"])
    with command.main_context():
        collector = LinkCollector.create(command.get_default_session(options), options)
        for path in map(Path, paths):
            lines = []
            for line in path.read_text(encoding="utf-8").splitlines():
                pinned = line.split()[0]
                name, _, version = pinned.partition("==")
                found = links(collector, canonicalize_name(name))
                good = {
                    link.hash
                    for link in found
                    if link.hash_name == "sha256" and wanted(link.filename, Version(version))
                }
                if not good:
                    raise SystemExit(f"{pinned}: the index has no such release, or no hashes of it")
                lines.append(" ".join([pinned, *(f"--hash=sha256:{one}" for one in sorted(good))]))
            path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
